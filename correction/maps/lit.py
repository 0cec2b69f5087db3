"""Light on the nodes of a map: how bright the sheet is behind the bodies, and what is too dark or too bright.

The light is traced on every n-th node (`tracer.strategies.light_map`), at most MOST_NODES along a side.  A node
beside a ball gets light from one side only; its brightness is divided by the part of its cell that is gas.
"""

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import scipy
from numpy.typing import NDArray

from correction.grid import PlaneGrid
from correction.maps.correction_map import CorrectionMap, nodes_in_glass
from correction.maps.light_height import LEVEL_MM, at_light
from correction.node_status import NodeStatus
from tracer.bodies import CONTACT_TOL_MM
from tracer.scene.scene import Scene
from tracer.strategies.light_map import LightMap, trace_light

T = TypeVar("T", bound=np.generic)
MOST_NODES = 640
LEAST_BRIGHTNESS, MOST_BRIGHTNESS = 0.25, 4.0  # relative to the undisturbed sheet; beyond, a node is masked
LEAST_GAS = 0.3  # of a cell: below, most of it is glass


@dataclass(frozen=True)
class PlaneLight:
    """Light of the sheet on the plane of a map.

    Parameters
    ----------
    grid : PlaneGrid
        Nodes (h, w) on which it was traced.
    light : LightMap
        Brightness there relative to the undisturbed sheet, height and thickness.
    every : int
        Nodes of the map for one of them, along each side.
    """

    grid: PlaneGrid
    light: LightMap
    every: int

    @property
    def is_bent(self) -> bool:
        """Return whether the light lies beside the plane of the sheet anywhere."""
        return bool(np.nanmax(np.abs(self.light.height_mm)) > LEVEL_MM)

    def too_dark(self) -> NDArray[np.bool_]:
        """Nodes (h, w) with less than LEAST_BRIGHTNESS."""
        return np.asarray(self.light.brightness < LEAST_BRIGHTNESS)

    def too_bright(self) -> NDArray[np.bool_]:
        """Nodes (h, w) with more than MOST_BRIGHTNESS."""
        return np.asarray(self.light.brightness > MOST_BRIGHTNESS)

    def on(self, field: NDArray[T], shape: tuple[int, int]) -> NDArray[T]:
        """Return a field (h, w) on all nodes of the map (H, W)."""
        wide = np.repeat(np.repeat(field, self.every, axis=0), self.every, axis=1)
        return wide[: shape[0], : shape[1]]

    def height_at(self, points_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        """Height (...) [mm] of the light at points (..., 2) of the plane; 0 where there is none."""
        moment, brightness = self._moments_at(points_mm)
        return np.asarray(moment / np.where(brightness > 0.0, brightness, 1.0))

    def height_where_lit(self, points_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        """Height (...) [mm] of the light at points (..., 2) of the plane; NaN where it is too dark."""
        moment, brightness = self._moments_at(points_mm)
        lit = brightness >= LEAST_BRIGHTNESS
        return np.where(lit, moment, np.nan) / np.where(lit, brightness, 1.0)

    def _moments_at(self, points_mm: NDArray[np.float64]) -> list[NDArray[np.float64]]:
        """Brightness times height, and brightness (...), at points (..., 2) of the plane."""
        light = self.light
        u, v = np.moveaxis(self.grid.to_px(points_mm), -1, 0)
        known = np.where(np.isfinite(light.height_mm), light.brightness, 0.0)
        moments = known * np.nan_to_num(light.height_mm), known
        return [scipy.ndimage.map_coordinates(one, (v, u), order=1, mode="nearest") for one in moments]


def light_of(scene: Scene, grid: PlaneGrid) -> PlaneLight | None:
    """Trace the light of a scene in its sheet to the nodes of a grid; None if its file gives no source.

    Raises
    ------
    SceneError
        No light reaches the nodes.
    """
    if scene.light is None:
        return None
    every = -(-max(grid.shape) // MOST_NODES)
    coarse = grid.every(every)
    light = trace_light(scene, scene.light, coarse.origin_mm, coarse.pitch_mm, coarse.shape)
    light.brightness[:] /= np.maximum(_gas_share(scene, coarse), LEAST_GAS)
    return PlaneLight(coarse, light, every)


def through_light(found: CorrectionMap, scene: Scene, lit: PlaneLight | None) -> CorrectionMap:
    """Return a map of the light's surface, without nodes that it lights too little or too much.

    It is the same map without a source.

    Parameters
    ----------
    found : CorrectionMap
        Of the scene.
    scene : Scene
        In its light sheet.
    lit : PlaneLight, optional
        `light_of` the scene on the map's grid.
    """
    if lit is None:
        return found
    for nodes, why in ((lit.too_dark(), NodeStatus.DARK), (lit.too_bright(), NodeStatus.OVERLIT)):
        found = found.without(lit.on(nodes, found.grid.shape) & found.recovered, why)
    return at_light(found, scene, lit.height_at(found.grid.nodes_mm()))


def _gas_share(scene: Scene, grid: PlaneGrid) -> NDArray[np.float64]:
    """Part (h, w) of the cell of each node, one pitch each way and weighted linearly, outside of bodies."""
    share = np.ones(grid.shape)
    inside, nodes_mm = nodes_in_glass(scene, grid), grid.nodes_mm()
    if inside is None:
        return share
    places = np.concatenate((nodes_mm, np.zeros((*grid.shape, 1))), axis=-1)
    edge = np.zeros(grid.shape, np.bool_)
    for step in ((0, 1), (0, -1), (1, 0), (-1, 0)):
        edge |= inside != np.roll(inside, step, axis=(0, 1))
    near = np.full(int(edge.sum()), np.inf)
    for body in scene.seen:
        if body.lowest_mm < -CONTACT_TOL_MM and body.room is None:
            near = np.minimum(near, body.distance_mm(places[edge]))
    away = np.clip(near / grid.pitch_mm, -1.0, 1.0)  # weights fall linearly, their sums are parabolas
    share[edge] = np.where(away > 0.0, 1.0 - 0.5 * (1.0 - away) ** 2, 0.5 * (1.0 + away) ** 2)
    return share
