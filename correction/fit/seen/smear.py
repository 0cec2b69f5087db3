"""Bias of smeared corners: by the colours of the light, by the pupil of the lens.

Behind glass each colour shows a corner elsewhere, and so does each part of the pupil (`tracer.strategies.blur`).

With u the corner's pixel at the mean index and X_k what colour k shows, colour k shows the corner at u + d_k with

    X_k(u + d_k) = X(u),

found by Newton's method.  The corner is then drawn as its colours show it side by side, and fitted as those of
the frame are (`find_smeared`): where the fit finds it is its shift, which is taken off, so that the scene is
fitted at the mean index alone.  A series will not do where the smear is wider than the edge's own blur: through
plastics in white light colours lie 1.4 px apart (standard deviation) to a blur of 0.5, and what
follows was 0.17 px off.  How wide the smear is goes into the corner's sigma: no spectrum is known to better than
SMEAR_SIGMA of its width.

A pupil is even, and narrower than the blur.  An edge with unit normal m is smeared by the distribution of
s_k = m . d_k with weights w_k: mean s, variance v, third moment t.  To the fitted blur B of the edge (variance
B^2, v in it) that is a step that is not even, and least squares puts it at

    s - t / (12 B^2)

(first order of the Gram-Charlier series: the odd part of the smeared step, projected on a shift of it).  Both
edges together give the corner's shift.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from correction.target.corners import find_smeared
from tracer.light import Light
from tracer.pupil import Pupil
from tracer.scene.scene import Scene
from tracer.strategies.blur import pupil_views
from tracer.strategies.sensitivity import Landings, TargetPose, landings_through
from tracer.strategies.trace import world_from

COLOURS = 12
NEWTON_ROUNDS = 3  # of Newton's method: 1e-4 px after two
SMEAR_SIGMA = 0.03  # of the smear by colour, as a corner's standard deviation
SLOPE = 0.25  # of the variance of the blur, by which it may draw corners aside
SHARPEST_PX = 0.35  # blur of a camera without lens
UNEVEN = 0.1  # of a shift by the pupil: none is quite round, nor as wide as engraved
# Of one by colours: no camera's blur is Gaussian, and rendered ones leave 0.05 to 0.2 of it
UNEVEN_COLOURS = 0.2


@dataclass(frozen=True)
class Dispersion:
    """Difference of the glass of a scene from its mean index, colour by colour.

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
        step = [[m.n(float(nm)) - light.index(m) if m else 0.0 for m in media] for nm in lengths]
        return cls(np.array(step).reshape(len(lengths), -1), weight)


@dataclass(frozen=True)
class Smear:
    """Of N corners.

    Parameters
    ----------
    shift_px : (N, 2) float64
        Where the corner seems to be, minus where it is at the mean index.
    width_px : (N,) float64
        Standard deviation of the colours along the way on which they lie.
    edges_px2 : (N, 2) float64
        Variance across the edges along the board's +x and +y.
    """

    shift_px: NDArray[np.float64]
    width_px: NDArray[np.float64]
    edges_px2: NDArray[np.float64]


def join_smears(parts: Sequence[Smear]) -> Smear:
    """Smear of all corners of several."""
    return Smear(
        np.concatenate([part.shift_px for part in parts]),
        np.concatenate([part.width_px for part in parts]),
        np.concatenate([part.edges_px2 for part in parts]),
    )


def uneven_blur(
    index: NDArray[np.int64], branch: NDArray[np.integer[Any]], axes_px: NDArray[np.float64], smear: Smear
) -> NDArray[np.float64]:
    """Return the bias (N, 2) [px] of corners from a blur that is not uniform over their windows.

    Where the variance of a blur rises, an edge is drawn aside by a share of its slope that depends on how the blur
    lies to slope and edge: up to a half.  That is a measure, no correction: corners rendered behind two balls at
    f/11 are 0.04 px aside at the border of the view, where a quarter of the slope is 0.022, and 0.00-0.02 within,
    where it is 0.012-0.022.

    Parameters
    ----------
    index : (N, 2) int64
        Corner of the board.
    branch : (N,) int
        Way through the glass, as a number.
    axes_px : (N, 2, 2) float64
    smear : Smear
    """
    variance, slope = smear.width_px**2, np.zeros((len(index), 2))
    place = {(int(b), int(i), int(j)): n for n, (b, (i, j)) in enumerate(zip(branch, index, strict=True))}
    for n, (b, (i, j)) in enumerate(zip(branch.tolist(), index.tolist(), strict=True)):
        for axis, (di, dj) in enumerate(((1, 0), (0, 1))):
            ahead, behind = place.get((b, i + di, j + dj), n), place.get((b, i - di, j - dj), n)
            apart = (ahead != n) + (behind != n)
            slope[n, axis] = (variance[ahead] - variance[behind]) / max(apart, 1)
    return np.asarray(SLOPE * np.linalg.solve(axes_px.transpose(0, 2, 1), slope[:, :, None])[:, :, 0])


def colour_steps(
    scene: Scene, pose: TargetPose, dispersion: Dispersion, pixels: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return places of corners in each of K colours, and its share; nothing where a ray does not land.

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

    Returns
    -------
    (K, N, 2) float64
        From where the corners are [px].
    (K, N) float64
    """
    mean = _land(scene, pose, pixels, np.zeros(len(scene.spheres)))
    steps = np.zeros((len(dispersion.index_step), *pixels.shape))
    for steps_of, index_step in zip(steps, dispersion.index_step, strict=True):
        for _ in range(NEWTON_ROUNDS):
            steps_of += _land(scene, pose, pixels + steps_of, index_step).step_px(mean)
    return np.nan_to_num(steps), np.array(np.broadcast_to(dispersion.weight[:, None], steps.shape[:2]))


def smear_by_colour(
    steps: NDArray[np.float64],
    share: NDArray[np.float64],
    axes_px: NDArray[np.float64],
    window: NDArray[np.float64],
    blurs_px: NDArray[np.float64],
) -> Smear:
    """Smear of corners as it is found in the frame, its variance as fitted edges take it up.

    Parameters
    ----------
    steps, share, axes_px
        As of `smear_of`.
    window : (N,) float64
        Half length of the window [squares].
    blurs_px : (N, 2) float64
        As measured, smear included.
    """
    out = smear_of(steps, share, axes_px, np.sqrt(np.mean(blurs_px**2, axis=1)))
    asked = steps.any(axis=(0, 2)) & np.isfinite(blurs_px).all(axis=1)
    own = np.maximum(np.mean(blurs_px**2 - out.edges_px2, axis=1)[asked], SHARPEST_PX**2)
    drawn = axes_px[asked], window[asked], np.sqrt(own), steps[:, asked], share[:, asked]
    aside, blurs = find_smeared(*drawn)
    found = np.isfinite(aside[:, 0])
    here = np.flatnonzero(asked)[found]
    out.shift_px[here], out.edges_px2[here] = aside[found], (blurs**2 - own[:, None])[found]
    return out


def smear_of(
    steps: NDArray[np.float64],
    share: NDArray[np.float64],
    axes_px: NDArray[np.float64],
    blur_px: NDArray[np.float64],
) -> Smear:
    """Smear of corners that K parts of the light show elsewhere.

    Parameters
    ----------
    steps : (K, N, 2) float64
        Where each part shows them, from where they are [px].
    share : (K, N) float64
        Of each part, 1 in sum over the parts.
    axes_px : (N, 2, 2) float64
        Columns: one square along the board's +x, +y in the frame.
    blur_px : (N,) float64
        Measured standard deviation of the edge spread.
    """
    off = steps - np.einsum("kn,kni->ni", share, steps)
    spread = np.einsum("kn,kni,knj->nij", share, off, off)
    along = axes_px.transpose(0, 2, 1)  # (N, edge, 2)
    normal = np.stack((-along[:, :, 1], along[:, :, 0]), axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    across = np.einsum("nei,kni->kne", normal, steps)
    middle = np.einsum("kn,kne->ne", share, across)
    variance = np.einsum("kn,kne->ne", share, (across - middle) ** 2)
    third = np.einsum("kn,kne->ne", share, (across - middle) ** 3)
    blur2 = np.where(np.isfinite(blur_px), blur_px, 0.0)[:, None] ** 2
    edge = middle - third / (12.0 * np.maximum(blur2, variance + 1e-12))
    shift = np.linalg.solve(normal, edge[:, :, None])[:, :, 0]
    return Smear(shift, np.sqrt(np.trace(spread, axis1=1, axis2=2)), variance)


def pupil_smear(
    scene: Scene,
    pupil: Pupil,
    pose: TargetPose,
    pixels: NDArray[np.float64],
    axes_px: NDArray[np.float64],
    blur_px: NDArray[np.float64],
) -> Smear:
    """Predict what the pupil does to corners; arguments as of `colour_steps` and `smear_of`.

    The print has one brightness towards all parts of the pupil, so that each counts by the light it lets through.
    """
    views = pupil_views(scene, pupil, pixels, pose)
    total = views.light.sum(axis=0)
    share = views.light / np.where(total > 0.0, total, 1.0)
    return smear_of(np.nan_to_num(views.offset_px), share, axes_px, blur_px)


def _land(
    scene: Scene, pose: TargetPose, pixels: NDArray[np.float64], index_step: Sequence[float] | NDArray[np.float64]
) -> Landings:
    """Landings with the index of every sphere moved."""
    table = scene.sphere_table()
    table[:, 4] += np.asarray(index_step) / [scene.n_around(sphere) for sphere in scene.spheres]
    world = world_from(table, scene.other_tables(), scene.rooms(), scene.shapes())
    return landings_through(scene.camera, world, pixels, pose, scene.n_ambient)
