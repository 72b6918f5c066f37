"""Where every figure of README and docs comes from; run them from the checkout.

    python -m benchmarks.speed.describe --help

    speed/       how long things take, and how much memory
    accuracy/    how often they are right: on the shared photos beside the checkout, where these are there
    paper/       the paper's rows on your own copies of its data sets

A package, though nothing installs it: a benchmark says by name what it takes of another.
"""
