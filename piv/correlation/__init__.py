"""Particle image velocimetry of one pair: prepare, search, refine, judge; `pair` puts them together."""
