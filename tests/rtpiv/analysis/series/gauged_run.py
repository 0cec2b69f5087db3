"""Runs whose bench had gauges."""

from daq.runs.journal import Journal
from daq.runs.run_folder import RunFolder
from tests.daq.small_run import keep_step

UTC = "2026-01-01T00:00:00.000+00:00"


def showed(value, unit="l/min", utc=UTC):
    return {"utc": utc, "unit": unit} | ({"missing": "it is silent"} if value is None else {"value": value})


def gauged(run, *steps):
    """The run with lines of its steps, each with what the gauges showed; a step may be taken again."""
    journal = Journal(RunFolder(run).journal_path)
    for step, readings in steps:
        keep_step(journal, step, readings=readings)
    journal.close()
    return run
