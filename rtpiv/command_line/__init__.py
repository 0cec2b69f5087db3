"""The command line: it calls a verb and returns an exit code, with one sentence for an error."""
