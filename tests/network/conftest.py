"""Photos of a few places and a run of a few steps, for aggregators that are trained."""

from tiny_runs import *  # noqa: F403  # fixtures are found by being here
