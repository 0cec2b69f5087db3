"""Frames of a flow made ready: what stands still is taken off, particles are brought to one height."""
