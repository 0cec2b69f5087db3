"""Timing units as firmware: bytes in, pulses out."""
