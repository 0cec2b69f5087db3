"""Benches and runs that the tests of stages and runs are made with."""

from tests.daq.runs.conftest import done_run, whole_run
from tests.stages.conftest import bench
from tests.watched_benches import witnesses

__all__ = ["bench", "done_run", "whole_run", "witnesses"]
