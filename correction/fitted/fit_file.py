"""Store what a fit found beside its scene: numbers, sigmas, covariance, corners, the verdict on the model.

``scene.yaml`` is what the tracer reads.  The fit file keeps the rest, for whoever carries uncertainty on:
the free numbers by name with values and covariance in their own units, every corner with its residual and the
smooth part of it, and what the test of the model says.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from correction.fit.judge.result import SceneFit
from correction.fitted.scene_sigma import KIND, FitHeader, SceneSigma
from ground.errors import MapFileError
from ground.map_file import checked, load_arrays, save_arrays
from ground.short_repr import short_repr


class VerdictHeader(FitHeader):
    """What the header of a fit file says of the model."""

    right: bool
    verdict: Annotated[list[str], Field(max_length=1000)]
    ways: Annotated[list[str], Field(max_length=100_000)]


@short_repr
@dataclass(frozen=True)
class StoredVerdict:
    """What a fit file says of the model.

    Parameters
    ----------
    scene_hash : str
        Of the fitted scene.
    right : bool
        Whether nothing speaks against the model.
    sentences : tuple of str
        The verdict in words.
    ways : tuple of str
        Ways through the glass that corners are seen on; empty for the direct view.
    way : (N,) int64
        Number of the way of every corner.
    pixel, smooth_px : (N, 2) float64
        Where corners were measured, and the smooth part of their residuals, raw px.
    """

    scene_hash: str
    right: bool
    sentences: tuple[str, ...]
    ways: tuple[str, ...]
    way: NDArray[np.int64]
    pixel: NDArray[np.float64]
    smooth_px: NDArray[np.float64]

    @classmethod
    def of(cls, fit: SceneFit) -> "StoredVerdict":
        """What `save_fit` stores of it."""
        ways, way = np.unique(fit.corners.branch_name, return_inverse=True)
        verdict, scene_hash = fit.verdict, fit.measured_scene.content_hash()
        names = tuple(map(str, ways.tolist()))
        return cls(
            scene_hash, verdict.is_right, verdict.sentences, names, way, fit.corners.pixel, verdict.smooth_px
        )


def save_fit(path: Path | str, fit: SceneFit) -> None:
    """Write a fit, atomically.

    Header: ``names``, ``numbers``, ``scene_hash``, ``nominal_hash``, ``frames``, ``history``,
    ``systematic_px`` (way -> its own error), ``shape_balls`` (`ShapeRoot`), ``right``, ``verdict`` and ``ways``
    (`StoredVerdict`).  Arrays:
    ``values`` (P,), ``covariance`` (P, P) in the units of the names, ``scene_root`` (Q, R) (see `SceneSigma`),
    ``shape_root`` (5 B, R),
    ``corner_frame``, ``corner_way`` (N,), ``corner_index`` (N, 2), ``corner_px``, ``residual_px``, ``smooth_px``
    (N, 2), ``behind``, ``inlier`` (N,).
    """
    unit, corners, found = fit.unknowns.sigma, fit.corners, StoredVerdict.of(fit)
    sigma = SceneSigma.of(fit)
    header = {
        "names": list(fit.names),
        "numbers": list(sigma.numbers),
        "scene_hash": found.scene_hash,
        "nominal_hash": fit.unknowns.scene.content_hash(),
        "frames": list(fit.frames),
        "history": [str(step) for step in fit.history],
        "systematic_px": fit.verdict.systematic_px,
        "shape_balls": list(sigma.shapes.balls),
        "right": found.right,
        "verdict": list(found.sentences),
        "ways": list(found.ways),
    }
    arrays = {
        "values": fit.values,
        "covariance": fit.covariance * np.outer(unit, unit),
        "scene_root": sigma.root,
        "shape_root": sigma.shapes.root,
        "corner_frame": corners.frame.astype(np.int32),
        "corner_way": found.way.astype(np.int32),
        "corner_index": corners.index.astype(np.int32),
        "corner_px": corners.pixel,
        "residual_px": corners.residual_px,
        "smooth_px": found.smooth_px,
        "behind": corners.behind.astype(np.uint8),
        "inlier": corners.inlier.astype(np.uint8),
    }
    save_arrays(path, KIND, header, {name: np.ascontiguousarray(array) for name, array in arrays.items()})


def load_verdict(path: Path | str) -> StoredVerdict:
    """Read what a fit file says of the model.

    Raises
    ------
    MapFileError
        The file is damaged, or of a version that did not store it.
    """
    header, arrays = load_arrays(path, KIND)
    if not {"verdict", "ways"} <= header.keys():
        raise MapFileError(f"{path}: does not hold the test of its model; run the calibration again")
    said = checked(path, header, VerdictHeader)
    way, pixel, smooth = (arrays.get(name) for name in ("corner_way", "corner_px", "smooth_px"))
    if way is None or pixel is None or smooth is None:
        raise MapFileError(f"{path}: does not hold the test of its model; run the calibration again")
    known = way.dtype.str == "<i4" and way.ndim == 1 and bool(np.all((way >= 0) & (way < len(said.ways))))
    places = all(one.dtype.str == "<f8" and one.shape == (*way.shape, 2) for one in (pixel, smooth))
    if not known or not places or not np.isfinite([pixel, smooth]).all():
        raise MapFileError(f"{path}: arrays do not fit together; run the calibration again")
    number = way.astype(np.int64)
    return StoredVerdict(said.scene_hash, said.right, tuple(said.verdict), tuple(said.ways), number, pixel, smooth)
