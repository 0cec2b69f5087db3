"""Frames of an evaluated pair, corrected again, and its displacement at one place by windows of other sizes."""

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from correction.fitted.prepared import prepare
from correction.grid import PlaneGrid
from daq.runs.acquired import read_acquired
from ground.errors import RtpivError
from ground.plain_file import read_plain
from piv.correlation.pair import evaluate_pair
from piv.correlation.settings import PivSettings
from tracer.scene.scene import Scene
from tracer.scene.scene_file import load_scene

SIDES_PX = (16, 24, 32, 48, 64, 96)  # windows that are tried at one place
CROP = 6  # sides around the place: passes have vectors around it to go by
LEAST_CROP_PX = 192
MAX_SUMMARY_BYTES = 100_000_000  # of evaluation.json


@dataclass(frozen=True, eq=False)
class PairFrames:
    """Corrected frames of a pair, with the nodes that they show.

    Parameters
    ----------
    a, b : ndarray of float32, shape (h, w)
        Corrected frames; NaN where nothing is recovered.
    valid : ndarray of bool, shape (h, w)
        Recovered nodes.
    grid : PlaneGrid
        Places of their pixels.
    settings : PivSettings
        With which the pair was evaluated.
    """

    a: NDArray[np.float32]
    b: NDArray[np.float32]
    valid: NDArray[np.bool_]
    grid: PlaneGrid
    settings: PivSettings

    def vectors_at(self, x: float, y: float) -> Iterator[dict[str, Any]]:
        """Evaluate the surroundings of a place again, with windows of several sizes.

        Parameters
        ----------
        x, y : float
            Place, in the unit of the file.

        Yields
        ------
        dict
            ``side`` of the last windows; ``u``, ``v`` (up), their ``sigma_u``, ``sigma_v`` (random and unresolved
            part together) and the distance ``off`` of the vector from the place [px], if it is valid; else
            ``flag``, or ``refused`` with the reason.
        """
        column, row = self.grid.to_px(np.array([[x, y]]))[0]
        for side in SIDES_PX:
            reach = max(CROP * side, LEAST_CROP_PX) // 2
            top, left = max(int(row) - reach, 0), max(int(column) - reach, 0)
            part = slice(top, int(row) + reach), slice(left, int(column) + reach)
            passes = (*dict.fromkeys(max(first, side) for first in self.settings.windows_px), side)
            settings = replace(self.settings, windows_px=passes, finest_px=None)
            try:
                field = evaluate_pair(self.a[part], self.b[part], self.valid[part], settings)
            except RtpivError as error:
                yield {"side": side, "refused": str(error)}
                continue
            i = int(np.argmin(np.abs(field.y_px + top - row)))
            k = int(np.argmin(np.abs(field.x_px + left - column)))
            found: dict[str, Any] = {"side": side}
            if field.valid[i, k]:
                sigma_u, sigma_v = field.total_sigma_px[i, k]
                off = np.hypot(field.x_px[k] + left - column, field.y_px[i] + top - row)
                numbers = {
                    "u": field.u_px[i, k],
                    "v": -field.v_px[i, k],
                    "sigma_u": sigma_u,
                    "sigma_v": sigma_v,
                    "off": off,
                }
                found |= {name: float(number) for name, number in numbers.items() if np.isfinite(number)}
            else:
                names = ("valid", "masked", "replaced as an outlier", "rejected", "light stands still")
                found["flag"] = names[int(field.flags[i, k])]
            yield found


def frames_of_pair(vector_file: Path, scene_hash: object, scene: Path | None) -> PairFrames | str:
    """Read and correct the frames of an evaluated pair.

    Parameters
    ----------
    vector_file : Path
        ``vectors.nc`` of `evaluate`; ``evaluation.json`` beside it names the frames.
    scene_hash : object
        Hash of the scene that the vectors were evaluated with, as their file has it.
    scene : Path, optional
        scene.yaml; default the one beside the file.

    Returns
    -------
    PairFrames or str
        The frames, or the reason why there are none.
    """
    try:
        about = json.loads(read_plain(vector_file.with_name("evaluation.json"), MAX_SUMMARY_BYTES))
        frames = [Path(about["frames_from"]) / name for name in about["frames"].split(", ")]
        chosen = about["correlation"]
        settings = PivSettings(**(chosen | {"windows_px": tuple(chosen["windows_px"])}))
        first, second = frames
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return "no evaluation.json of one pair beside the file, so frames and other windows are not available"
    path = scene or vector_file.with_name("scene.yaml")
    if not path.is_file():
        return f"frames are not shown: {path} does not exist; pass the scene of the evaluation with --scene"
    try:
        used = _scene_with_hash(load_scene(path), scene_hash)
        if used is None:
            return f"frames are not shown: {path} is not the scene that the pair was evaluated with; pass --scene"
        corrector = prepare(used).corrector
        a, b = (corrector(read_acquired(frame, used.camera.shape)) for frame in (first, second))
    except (RtpivError, OSError) as error:
        return f"frames are not shown: {error}"
    return PairFrames(a, b, corrector.recovered, corrector.map.grid, settings)


def _scene_with_hash(scene: Scene, wanted: object) -> Scene | None:
    """Return the scene of a hash: as it is, or with its plane in the light sheet."""
    return next((each for each in (scene, scene.in_light_sheet()) if each.content_hash() == wanted), None)
