"""Runs: what one acquisition leaves on the disk, and what can be read from it again."""
