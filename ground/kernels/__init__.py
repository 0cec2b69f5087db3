"""Compiled loops that any package uses."""
