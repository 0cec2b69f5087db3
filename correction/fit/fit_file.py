"""Store what a fit found beside its scene: numbers, sigmas, covariance, corners.

``scene.yaml`` is what the tracer reads.  The fit file keeps the rest, for whoever carries uncertainty on:
the free numbers by name with values and covariance in their own units, and every corner with its residual.
"""

from pathlib import Path

import numpy as np

from correction.fit.result import SceneFit
from correction.fit.scene_sigma import KIND, SceneSigma
from ground.map_file import save_arrays


def save_fit(path: Path | str, fit: SceneFit) -> None:
    """Write a fit, atomically.

    Header: ``names``, ``scene_hash``, ``nominal_hash``, ``frames``, ``history``,
    ``systematic_px`` (way -> its own error).  Arrays: ``values`` (P,),
    ``covariance`` (P, P) in the units of the names, ``scene_root`` (Q, P) (see `SceneSigma`), ``corner_frame``
    (N,), ``corner_index`` (N, 2), ``corner_px``, ``residual_px`` (N, 2), ``behind``, ``inlier`` (N,).
    """
    unit, corners = fit.unknowns.sigma, fit.corners
    header = {
        "names": list(fit.names),
        "scene_hash": fit.measured_scene.content_hash(),
        "nominal_hash": fit.unknowns.scene.content_hash(),
        "frames": list(fit.frames),
        "history": [str(step) for step in fit.history],
        "systematic_px": fit.verdict.systematic_px,
    }
    arrays = {
        "values": fit.values,
        "covariance": fit.covariance * np.outer(unit, unit),
        "scene_root": SceneSigma.of(fit).root,
        "corner_frame": corners.frame.astype(np.int32),
        "corner_index": corners.index.astype(np.int32),
        "corner_px": corners.pixel,
        "residual_px": corners.residual_px,
        "behind": corners.behind.astype(np.uint8),
        "inlier": corners.inlier.astype(np.uint8),
    }
    save_arrays(path, KIND, header, {name: np.ascontiguousarray(array) for name, array in arrays.items()})
