"""Verbs of the command line; each is a function to call from a notebook as well."""
