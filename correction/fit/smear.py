"""Where a corner seems to stand in light of many colours: behind glass each colour shows it elsewhere.

With u the corner's pixel at the mean index and X_k(u) what colour k shows there, colour k shows the corner at

    u + d_k,        d_k = -J_k^-1 (X_k(u) - X(u)),

so an edge with unit normal m is smeared by the distribution of s_k = m . d_k with weights w_k: mean s, variance v,
third moment t.  To the fitted blur B of the edge (variance B^2, v in it) the smear is a step that is not even, and
least squares puts it at

    s - t / (12 B^2)

(first order of the Gram-Charlier series: the odd part of the smeared step, projected on a shift of it).  Both
edges together give the corner's shift, which is taken off before the fit; the fit then works at the mean index
alone.  How wide the smear is goes into the corner's sigma: no spectrum is known to better than UNSURE of its
width.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tracer.cells import world_from
from tracer.light import Light
from tracer.scene import Scene
from tracer.sensitivity import Landings, TargetPose, landings_through

COLOURS = 12
UNSURE = 0.03  # of the smear, as a corner's standard deviation


@dataclass(frozen=True)
class Dispersion:
    """How the glass of a scene differs from its mean index, colour by colour.

    Parameters
    ----------
    index_step : (K, S) float64
        Index of every sphere in every colour minus the mean; spheres in front of the plane, in file order.
    weight : (K,) float64
        Share of each colour, 1 in sum.
    """

    index_step: NDArray[np.float64]
    weight: NDArray[np.float64]

    @classmethod
    def of(cls, scene: Scene, light: Light) -> "Dispersion":
        """Dispersion of the media of a scene in a light; opaque spheres have none."""
        lengths, weight = light.colours(COLOURS)
        media = [sphere.medium for sphere in scene.spheres]
        n = np.array([[m.n(float(nm)) if m else 1.0 for m in media] for nm in lengths]).reshape(len(lengths), -1)
        return cls(n - weight @ n, weight)


@dataclass(frozen=True)
class Smear:
    """Of N corners.

    Parameters
    ----------
    shift_px : (N, 2) float64
        Where the corner seems to be, minus where it is at the mean index.
    width_px : (N,) float64
        Standard deviation of the colours along the way on which they lie.
    """

    shift_px: NDArray[np.float64]
    width_px: NDArray[np.float64]


def smear_of(
    scene: Scene,
    pose: TargetPose,
    dispersion: Dispersion,
    pixels: NDArray[np.float64],
    axes_px: NDArray[np.float64],
    blur_px: NDArray[np.float64],
) -> Smear:
    """Predict the smear of corners; nothing where a ray does not land.

    Parameters
    ----------
    scene : Scene
        With the glass at its mean index.
    pose : TargetPose
        Of the target.
    dispersion : Dispersion
        Of the scene in the light.
    pixels : (N, 2) float64
        Corners.
    axes_px : (N, 2, 2) float64
        Columns: one square along the board's +x, +y in the frame.
    blur_px : (N,) float64
        Measured standard deviation of the edge spread.
    """
    mean = _landed(scene, pose, pixels, np.zeros(len(scene.spheres)))
    steps = np.array([_displaced(_landed(scene, pose, pixels, step), mean) for step in dispersion.index_step])
    steps = np.nan_to_num(steps)  # (K, N, 2)
    weight = dispersion.weight
    off = steps - np.einsum("k,kni->ni", weight, steps)
    spread = np.einsum("k,kni,knj->nij", weight, off, off)
    along = axes_px.transpose(0, 2, 1)  # (N, edge, 2)
    normal = np.stack((-along[:, :, 1], along[:, :, 0]), axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    across = np.einsum("nei,kni->kne", normal, steps)
    middle = np.einsum("k,kne->ne", weight, across)
    variance = np.einsum("k,kne->ne", weight, (across - middle) ** 2)
    third = np.einsum("k,kne->ne", weight, (across - middle) ** 3)
    edge = middle - third / (12.0 * np.maximum(blur_px[:, None] ** 2, variance + 1e-12))
    shift = np.linalg.solve(normal, edge[:, :, None])[:, :, 0]
    return Smear(shift, np.sqrt(np.trace(spread, axis1=1, axis2=2)))


def _landed(
    scene: Scene, pose: TargetPose, pixels: NDArray[np.float64], index_step: Sequence[float] | NDArray[np.float64]
) -> Landings:
    """Landings with the index of every sphere moved."""
    table = scene.sphere_table()
    table[:, 4] += np.asarray(index_step) / scene.n_ambient
    return landings_through(scene.camera, world_from(table, scene.other_tables()), pixels, pose, scene.n_ambient)


def _displaced(colour: Landings, mean: Landings) -> NDArray[np.float64]:
    """Pixels (N, 2) from where the mean shows a point to where a colour shows it."""
    j, off = colour.pixel_rate, colour.point_mm - mean.point_mm
    det = j[:, 0, 0] * j[:, 1, 1] - j[:, 0, 1] * j[:, 1, 0]
    u = (j[:, 1, 1] * off[:, 0] - j[:, 0, 1] * off[:, 1]) / det
    v = (j[:, 0, 0] * off[:, 1] - j[:, 1, 0] * off[:, 0]) / det
    return -np.stack((u, v), axis=-1)
