"""A pair by windows of one size, 32 px, for what is held of these alone."""

from piv.correlation import pair
from piv.correlation.settings import PivSettings


def evaluate_pair(frame_a, frame_b, valid=None, settings=None, **more):
    """Evaluate with the settings that are given, or with windows of one size."""
    return pair.evaluate_pair(frame_a, frame_b, valid, settings or PivSettings(), **more)
