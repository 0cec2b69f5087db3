"""The command line: a verb is called, and what came of it is an exit code and one sentence."""
