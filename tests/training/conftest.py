"""The small places, models and recipe that tests of training share."""

from tiny_runs import *  # noqa: F403  # fixtures are found by being here
