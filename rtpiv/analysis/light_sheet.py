"""From a run, or from frames that belong together, to the light sheet that their particles show."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from correction.fitted.scene_sigma import SceneSigma
from correction.light_sheet.disparities import Pair
from correction.light_sheet.self_calibration import SheetFound, find_sheet
from daq.errors import RunDamaged
from daq.frames.source import is_source, source_of
from daq.runs.acquired import read_acquired
from daq.runs.glass_place import glass_place_mm, with_glass_at
from daq.runs.names import is_run
from daq.runs.pairs import pairs_of
from ground.terminal import progress, say_once
from piv.errors import FrameError, PairError
from tracer.light_sheet import LightSheet
from tracer.scene.scene import Scene

T = TypeVar("T")
MOST_PAIRS = 200  # evenly from the whole run; more are not needed


@dataclass(frozen=True)
class FlowFrames:
    """Pairs of frames of particles.

    Parameters
    ----------
    pairs : tuple of (Path, Path)
        Frames A and B.
    scene : Scene
        What the camera looked through while they were taken.
    """

    pairs: tuple[tuple[Path, Path], ...]
    scene: Scene


def flow_frames(paths: Sequence[Path], fitted: Scene) -> FlowFrames:
    """Collect frames: of one run, of a source of pairs (`daq.frames`), or A, B, A, B ... as given.

    Raises
    ------
    PairError
        They show a print, no glass, or are no pairs.
    RunUnsuitable, RunDamaged
        The run cannot be read.
    """
    if len(paths) != 1 or not is_run(paths[0]):
        if len(paths) == 1 and is_source(paths[0]):
            places = [(first, second) for _, first, second in source_of(paths[0]).pairs()]
            return FlowFrames(tuple(_spread(places)), fitted)
        if not paths or len(paths) % 2:
            raise PairError(
                "give a flow run, a folder or pattern of frames in pairs, or these in order: A, B, A, B ..."
            )
        frames = list(paths)
        return FlowFrames(tuple(zip(frames[::2], frames[1::2], strict=True)), fitted)
    run = paths[0]
    pairs = [pair for pair in pairs_of(run).pairs if not pair.is_background]
    if any(pair.measured_mm is not None for pair in pairs):
        raise PairError(
            "shows a print on the target's stage, and no light sheet", place=run, cure="give a flow run"
        )
    pairs = [pair for pair in pairs if pair.glass]
    if not pairs:
        raise PairError(
            "was taken without the glass, and only glass shows particles twice", place=run, cure="give another"
        )
    chosen = _spread(pairs)
    scene = with_glass_at(fitted, glass_place_mm(run, [pair.frames[0] for pair in chosen]))
    return FlowFrames(tuple(pair.frames for pair in chosen), scene)


def _spread(pairs: Sequence[T]) -> list[T]:
    """As many as are needed, evenly from all."""
    chosen = np.linspace(0, len(pairs) - 1, min(len(pairs), MOST_PAIRS)).round().astype(int)
    return [pairs[k] for k in np.unique(chosen)]


def sheet_of(given: FlowFrames, sigma: SceneSigma | None = None) -> SheetFound:
    """Find the light sheet; `sigma` is that of the scene, if its fit is there.

    Raises
    ------
    SheetError, SceneError
        There are too few pairs that can be read, or the sheet runs through a body.
    """
    return find_sheet(given.scene, lambda: read_pairs(given, given.pairs, "looking at particles"), sigma)


def read_pairs(given: FlowFrames, pairs: Sequence[tuple[Path, Path]], what: str) -> Iterator[Pair]:
    """Read some of the pairs, float32, with a bar for what; one that cannot be read is said and left out."""
    shape = given.scene.camera.shape
    for pair in progress(pairs, len(pairs), what):
        try:
            first, second = (np.ascontiguousarray(read_acquired(frame, shape), np.float32) for frame in pair)
        except (FrameError, RunDamaged) as error:
            say_once(f"a pair is left out: {error}")
            continue
        yield first, second


def about_sheet(found: SheetFound, frames: Sequence[str]) -> dict[str, Any]:
    """Return the contents of sheet.json."""
    cells = found.cells
    fit = found.fit
    tree: dict[str, Any] = {
        "sheet": _numbers(found.sheet),
        "known_before": _numbers(found.known),
        "pairs": found.pairs,
        "rounds": found.rounds,
        "seen_twice_mm2": found.views.area_mm2,
        "views": [[list(way) for way in kind] for kind in found.views.kinds],
        "verdicts": list(found.verdicts),
        "frames": list(frames),
    }
    if cells is not None and fit is not None:
        tree |= {"scatter": fit.scatter, "across_px": fit.across_px}
        columns = zip(
            cells.place_mm.tolist(),
            cells.kind.tolist(),
            cells.height_mm.tolist(),
            cells.height_sigma_mm.tolist(),
            fit.residual_mm.tolist(),
            fit.weight.tolist(),
            strict=True,
        )
        names = ("place_mm", "views", "height_mm", "sigma_mm", "residual_mm", "weight")
        tree["cells"] = [dict(zip(names, row, strict=True)) for row in columns]
    return tree


def _numbers(sheet: LightSheet) -> dict[str, Any]:
    return dict(vars(sheet)) | {"correlation": list(sheet.correlation)}
