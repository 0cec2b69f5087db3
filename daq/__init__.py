"""The bench, the run, the command line."""
