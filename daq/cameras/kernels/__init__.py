"""Compiled loops of the bench: unpacking camera pixels."""
