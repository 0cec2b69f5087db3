"""Loops behind the analysis."""
