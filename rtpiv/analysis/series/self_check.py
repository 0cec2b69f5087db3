"""Checks of a run by some of its pairs: positions of its spheres, and height of its light sheet in a bed."""

from pathlib import Path

import numpy as np

from correction.errors import SheetError
from correction.light_sheet.by_brightness import BrightnessHeight, height_by_brightness
from correction.self_check.moved_sphere import SelfCheck, check_spheres
from daq.runs.names import is_run
from daq.runs.pairs import pairs_of
from piv.errors import PairError
from piv.files.vector_file import read_vectors
from rtpiv.analysis.fit_beside import SCENE_FILE
from rtpiv.analysis.light_sheet import FlowFrames, flow_frames, read_pairs
from rtpiv.analysis.series.series_folder import MEAN
from rtpiv.analysis.series.series_input import SeriesInput
from tracer.scene.scene_file import load_scene

ENOUGH_PAIRS = 50  # evenly from those given
ATTRIBUTES = ("self_check", "spheres_moved")


def self_check_of(given: FlowFrames) -> SelfCheck:
    """Ask the particles of some pairs.

    Raises
    ------
    SheetError, SceneError
        There are too few pairs that can be read, or the sheet runs through a body.
    """
    every = len(given.pairs)
    chosen = np.unique(np.linspace(0, every - 1, min(every, ENOUGH_PAIRS)).round().astype(int))
    pairs = [given.pairs[number] for number in chosen]
    return check_spheres(given.scene, lambda: read_pairs(given, pairs, "looking for spheres that have moved"))


def spheres_checked(folder: Path, series: SeriesInput | None) -> tuple[SelfCheck | None, dict[str, str]]:
    """Check the spheres of the run behind a series, and say what its mean.nc is to hold of that.

    Without the run at hand, this is what the mean.nc in the folder of the series holds already.
    """
    if series is None:
        kept = read_vectors(folder / MEAN).attributes if (folder / MEAN).is_file() else {}
        return None, {name: str(kept[name]) for name in ATTRIBUTES if name in kept}
    scene = load_scene(series.out / SCENE_FILE)
    try:
        found = self_check_of(flow_frames([series.run], scene)) if scene.bodies else None
    except (PairError, SheetError):
        found = None
    return found, found.attributes if found else {}


def check_sheet(series: SeriesInput) -> BrightnessHeight | None:
    """Compare the mean frame of the run behind a series with the traced light; None where that cannot be done."""
    scene = load_scene(series.out / SCENE_FILE)
    if scene.sheet is None or not scene.sheet.sources or not is_run(series.run):
        return None
    background = [pair.frames for pair in pairs_of(series.run).pairs if pair.is_background]
    if not background:
        return None
    given = flow_frames([series.run], scene)
    chosen = given.pairs[:: -(-len(given.pairs) // ENOUGH_PAIRS)]
    seen, still = (
        [np.mean(pair, axis=0, dtype=np.float64) for pair in read_pairs(given, pairs, what)]
        for pairs, what in ((chosen, "comparing brightness"), (background, "reading the background"))
    )
    if not seen or not still:
        return None
    return height_by_brightness(given.scene, np.mean(seen, axis=0) - np.mean(still, axis=0))
