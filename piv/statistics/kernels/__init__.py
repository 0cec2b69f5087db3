"""Loops of the ensemble correlation: products of frames cell by cell, and the fit of a peak."""
