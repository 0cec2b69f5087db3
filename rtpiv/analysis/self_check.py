"""From a flow run to what its particles say of the spheres: whether they stand where they were calibrated."""

import numpy as np

from correction.self_check.moved_sphere import SelfCheck, check_spheres
from rtpiv.analysis.light_sheet import FlowFrames, read_pairs

ENOUGH_PAIRS = 50  # evenly from those given


def self_check_of(given: FlowFrames) -> SelfCheck:
    """Ask the particles of some pairs.

    Raises
    ------
    SheetError, SceneError
        There are too few pairs, or the sheet runs through a body.
    FrameError, RunDamaged
        A frame cannot be read.
    """
    every = len(given.pairs)
    chosen = np.unique(np.linspace(0, every - 1, min(every, ENOUGH_PAIRS)).round().astype(int))
    pairs = [given.pairs[number] for number in chosen]
    return check_spheres(given.scene, lambda: read_pairs(given, pairs, "looking for spheres that have moved"))
