"""Observations in frames of a target: corners, outlines, pairing, smear and hidden parts."""
