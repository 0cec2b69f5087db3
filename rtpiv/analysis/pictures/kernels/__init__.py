"""Loops over millions of pixels behind the pictures."""
