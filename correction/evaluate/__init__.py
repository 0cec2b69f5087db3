"""Judgement of the correction: errors by region, claims of sigma, targets, and tracks of particles."""
