"""Correction through a finite aperture: nodes looked up where the centroids of their particles are.

Behind glass a pupil blurs, and near the rim it does so unevenly: at f/22 the centroid of a particle's picture lies
up to 0.1 px beside the chief ray, at f/5.6 a pixel (`tracer.strategies.blur`).  Where that is small it is taken
off; where a picture is wider than MAX_PICTURE_BLUR_PX, or its centroid farther off than MAX_MISFIT_PX, which a
model of a round, even pupil predicts no better than to a tenth, the node is left out as BLURRED.

The shift is smooth: it is traced at some NODES nodes behind glass, best view only, and interpolated between.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from correction.maps.correction_map import CorrectionMap
from correction.node_status import NodeStatus
from tracer.scene.scene import Scene
from tracer.strategies.blur import pupil_views

NODES = 30_000
MAX_PICTURE_BLUR_PX = 3.0  # standard deviation of a picture: windows and tracks still see particles of it
MAX_MISFIT_PX = 0.2
STEEP_PX = 0.01  # a smaller shift is the same at the centroid and at the chief ray
MOST_LOST = 0.05  # share of the pupil that does not show the node on its branch


@dataclass(frozen=True)
class BlurMap:
    """Blur of a corrected frame by the aperture.

    Parameters
    ----------
    shift_px : (h, w, 2) float64
        Centroid of a particle's picture minus its chief ray's pixel, sensor px; 0 without glass.
    width_px : (h, w) float64
        Standard deviation of the picture along its longer axis; NaN where nothing is seen through glass.
    lost : (h, w) float64
        Share of the pupil that does not show the node on its branch.
    """

    shift_px: NDArray[np.float64]
    width_px: NDArray[np.float64]
    lost: NDArray[np.float64]

    @property
    def left_out(self) -> float:
        """Share of the nodes seen through glass that are not usable."""
        behind = np.isfinite(self.width_px)
        return float(np.mean(~self.usable[behind])) if behind.any() else 0.0

    @property
    def usable(self) -> NDArray[np.bool_]:
        """Nodes (h, w) that are seen through glass and neither too blurred nor too far from their chief ray."""
        return _usable(self.shift_px, self.width_px, self.lost)


def _usable(
    shift_px: NDArray[np.float64], width_px: NDArray[np.float64], lost: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Pictures that are neither too wide nor too far from their chief ray."""
    with np.errstate(invalid="ignore"):
        near = np.hypot(*np.moveaxis(shift_px, -1, 0)) <= MAX_MISFIT_PX
        return np.asarray(near & (width_px <= MAX_PICTURE_BLUR_PX) & (lost <= MOST_LOST))


def blur_map(found: CorrectionMap, scene: Scene, nodes: int = NODES) -> BlurMap:
    """Blur at every node behind glass of a map; the scene's camera must have a pupil."""
    import cv2

    assert scene.camera.pupil is not None
    height, width = found.grid.shape
    behind = found.behind_glass
    step = max(1, round(float(np.sqrt(np.count_nonzero(behind) / nodes))))
    coarse = behind[::step, ::step]
    table = np.full((*coarse.shape, 4), np.nan)
    blur = pupil_views(scene, scene.camera.pupil, found.pixel[0, ::step, ::step][coarse]).of_particles()
    table[coarse] = np.column_stack((np.nan_to_num(blur.shift_px), blur.width_px, blur.lost))
    if (
        coarse.any()
    ):  # beyond the glass goes on what is next to it, so that nothing is mixed with what is not there
        nearest = scipy.ndimage.distance_transform_edt(~coarse, return_distances=False, return_indices=True)
        table = table[tuple(nearest)]
    columns, rows = np.meshgrid(np.arange(width) / step, np.arange(height) / step)
    at = columns.astype(np.float32), rows.astype(np.float32)
    fine = np.asarray(cv2.remap(table, *at, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), dtype=np.float64)
    fine[~behind] = (0.0, 0.0, np.nan, 0.0)
    return BlurMap(fine[..., :2], fine[..., 2], fine[..., 3])


def chief_pixels(
    scene: Scene, pixels: NDArray[np.float64], behind: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Take off raw centroids of particles what the pupil does to them: what follows traces chief rays.

    The shift is first that of the chief ray through the centroid itself; where that is large, once more that of
    the ray which it leads to.

    Parameters
    ----------
    scene : Scene
        With the camera's pupil; of a pinhole nothing is taken off.
    pixels : (N, 2) float64
        Centroids in the raw frame.
    behind : (N,) bool
        Which are seen through glass.

    Returns
    -------
    pixels : (N, 2) float64
        Of the chief rays.
    usable : (N,) bool
        False where the picture is too wide, or too far from its chief ray, as in a map.
    """
    if scene.camera.pupil is None or not behind.any():
        return pixels, np.ones(len(pixels), bool)
    moved, usable = np.array(pixels), np.ones(len(pixels), bool)
    which = np.flatnonzero(behind)
    for _ in range(2):
        blur = pupil_views(scene, scene.camera.pupil, moved[which]).of_particles()
        moved[which] = pixels[which] - np.nan_to_num(blur.shift_px)
        usable[which] = _usable(blur.shift_px, blur.width_px, blur.lost)
        which = which[np.hypot(*blur.shift_px.T) > STEEP_PX]  # False for NaN
    return moved, usable


def through_pupil(found: CorrectionMap, scene: Scene) -> CorrectionMap:
    """Return the map as the camera's pupil wants it; the same map for a pinhole, or where no glass is."""
    if scene.camera.pupil is None or not found.behind_glass.any():
        return found
    blur = blur_map(found, scene)
    beyond = found.behind_glass & ~blur.usable
    pixel, weight = found.pixel.copy(), found.weight.copy()
    right, bottom = found.sensor_px[0] - 1.0, found.sensor_px[1] - 1.0
    pixel[0] = np.clip(pixel[0] + blur.shift_px, 0.0, (right, bottom))
    pixel[:, beyond], weight[:, beyond] = np.nan, 0.0
    return replace(
        found,
        pixel=pixel,
        weight=weight,
        status=np.where(beyond, np.uint8(NodeStatus.BLURRED), found.status),
    )
