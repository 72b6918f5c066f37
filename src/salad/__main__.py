"""`python -m salad`, where the command itself is not on the path."""

from salad.cli.main import main

if __name__ == "__main__":
    main()
