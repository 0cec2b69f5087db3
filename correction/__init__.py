"""Frames as if the glass were not there, and what they are worth."""
