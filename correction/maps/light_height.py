"""The light of a sheet as a surface: behind bodies it lies at another height than the sheet does.

The light is a surface z = h(x, y) over the plane of the sheet (`tracer.strategies.light_map`).  A particle of node
X that is lit at the height h stands on the ray that meets the plane at X - h dX/dz.  So its pixel u moves by

    du = -(d pixel / d node) (P + h dX/dz - X) / pitch,      P where the ray of u meets the plane,

and once more where that was a long way.  A particle keeps its own height while it moves, so that displacements are
biased where h changes (`correction.maps.height_change`).

A sheet that lies dz higher lights its particles r dz higher, r = 1 + dh/dz: 1 without bodies, 0 at the focus of a
ball, negative beyond.  The uncertainty of the sheet's height and tilt is multiplied by r (`HeightRate`).
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from correction.grid import PlaneGrid, grid_of
from correction.maps.correction_map import CorrectionMap
from correction.node_status import NodeStatus
from tracer.bodies import translate_by
from tracer.scene.scene import Scene
from tracer.strategies.light_map import trace_light
from tracer.strategies.trace import trace

LEVEL_MM = 1e-4  # heights that are those of the plane: 0.0003 px behind two balls
CURVED_PX = 0.05  # a shorter way on the sensor is straight to 1e-3 px
NEWTON_STEPS = 4
LONGEST_STEP_PX = 30.0  # beyond, the node is not seen at that height on this branch
RATE_NODES = 160  # along a side of the raster of `HeightRate`, at most
RATE_STEPS = 0.05, 0.25  # thicknesses by which the sheet is moved for it: least and most, its sigma between


def at_light(found: CorrectionMap, scene: Scene, height_mm: NDArray[np.float64]) -> CorrectionMap:
    """Return a map whose nodes are looked up at a height over the plane.

    Nodes whose view at that height goes another way through the bodies are masked as hidden by a rim.

    Parameters
    ----------
    found : CorrectionMap
        Of the scene, of chief rays.
    scene : Scene
        In its light sheet.
    height_mm : (H, W) float64
        Of each node.
    """
    grid, pixel = found.grid, found.pixel.copy()
    nodes_mm = grid.nodes_mm()
    raised = np.abs(height_mm) > LEVEL_MM
    to_nodes = np.array((1.0, -1.0)) / grid.pitch_mm
    lost = np.zeros(found.weight.shape, np.bool_)
    for layer in range(found.layers):
        seen = raised & (found.weight[layer] > 0.0)
        jacobian = found.jacobian[layer][seen]
        to_px = jacobian.reshape(-1, 2, 2) * to_nodes
        feet = pixel[layer][seen]
        points = np.column_stack((nodes_mm[seen], height_mm[seen]))
        at, there = _pixels_at(scene, feet, to_px, points)
        pixel[layer][seen] = at
        lost[layer][seen] = ~there
    corner = np.array(found.sensor_px) - 1.0
    pixel = np.clip(pixel, 0.0, corner)  # NaN stays
    pixel[lost] = np.nan
    weight = np.where(lost, np.float32(0.0), found.weight)
    total = weight.sum(axis=0)
    whole = np.where(lost.any(axis=0) & (total > 0.0), total, 1.0)
    weight = np.asarray(weight / whole, np.float32)
    moved = replace(found, pixel=pixel, weight=weight)
    gone = found.recovered & (total == 0.0)
    return moved.without(gone, NodeStatus.RIM)


def _pixels_at(
    scene: Scene, pixels: NDArray[np.float64], to_px: NDArray[np.float64], points_mm: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Pixels (N, 2) that show points (N, 3), from those (N, 2) that show their feet, and whether they do (N,).

    `to_px` (N, 2, 2) is d pixel / d point [px/mm].
    """
    at, which = pixels.copy(), np.arange(len(pixels))
    there = np.ones(len(pixels), np.bool_)
    keys = np.zeros(len(pixels), np.int64)
    for turn in range(NEWTON_STEPS):
        rays, points = trace(scene, at[which]), points_mm[which]
        way = rays.rays["direction"]
        if turn == 0:
            keys = rays.rays["key"]
        slope = way[:, :2] / way[:, 2:]
        off = rays.plane_mm + points[:, 2:] * slope - points[:, :2]
        step = np.einsum("nij,nj->ni", to_px[which], off)
        size = np.hypot(*step.T)
        good = rays.recovered & (size < LONGEST_STEP_PX)
        good &= rays.rays["key"] == keys[which]
        at[which] -= np.where(good[:, None], step, 0.0)
        there[which[~good]] = False
        which = which[good & (size > CURVED_PX)]
        if not len(which):
            break
    there[which] = False  # no end was found
    return at, there


@dataclass(frozen=True)
class HeightRate:
    """Change of the height of the light with that of the sheet, dimensionless: 1 without bodies.

    Parameters
    ----------
    grid : PlaneGrid
        Nodes (h, w) on which it was traced.
    rate : (h, w) float64
        Millimetres that particles are lit higher if the sheet lies a millimetre higher.
    """

    grid: PlaneGrid
    rate: NDArray[np.float64]

    @classmethod
    def of(cls, scene: Scene) -> "HeightRate | None":
        """Trace the light of a scene in its sheet with the sheet moved; None if its file gives no source."""
        sheet = scene.light
        if sheet is None or sheet.thickness_mm is None:
            return None
        full = grid_of(scene.camera)
        grid = full.every(-(-max(full.shape) // RATE_NODES))
        least, most = (share * sheet.thickness_mm for share in RATE_STEPS)
        step_mm = min(max(sheet.sigma_mm, least), most)
        low, high = (
            trace_light(_lower_bodies(scene, way), sheet, grid.origin_mm, grid.pitch_mm, grid.shape).height_mm
            for way in (-step_mm, step_mm)
        )
        return cls(grid, 1.0 + np.nan_to_num((high - low) / (2.0 * step_mm)))

    def at(self, points_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        """Rate (N,) at points (N, 2) of the plane."""
        u, v = self.grid.to_px(np.nan_to_num(points_mm)).T
        return np.asarray(scipy.ndimage.map_coordinates(self.rate, (v, u), order=1, mode="nearest"))


def _lower_bodies(scene: Scene, by_mm: float) -> Scene:
    """Lower all bodies of a scene: to them its sheet lies higher."""
    down = translate_by((0.0, 0.0, -by_mm))
    return replace(scene, bodies=tuple(body.moved(down) for body in scene.bodies))
