"""Light of a sheet that comes from the side through bodies: rays from its sources, by the renderer's own optics.

Rays start across the width of each source at even steps, at quasi-random heights and angles, so that neighbours
cover them evenly, and go from body to body.  What they leave in boxes of the plane gives brightness, mean height
and thickness of the light there.  Across its height the light in a box is taken for a Gaussian, which it is
wherever one bundle of rays arrives.  Light that bodies reflect is lost.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from sim.flow.kernels.sheet_light import leave_light
from sim.flow.particles import LightSheet
from sim.renderer.patterns import Pose
from sim.renderer.render import tables_of
from tracer.bodies import Sphere
from tracer.light_sheet import SheetSource
from tracer.scene.scene import Scene

Float64 = NDArray[np.float64]
Raster = tuple[tuple[float, float], float, tuple[int, int]]

REACH = 2.0  # thicknesses from the middle within which light is counted
BOX = 0.25  # side in thicknesses, unless that makes more boxes than MOST_BOXES along a side
MOST_BOXES = 1000
RAYS_PER_BOX = 400
THINNEST = 0.1  # thicknesses: a focus by geometrical optics alone would shine without limit
LEAST_LIGHT = 1e-6
LEAST_GAS = 0.1  # of a box
STEPS = 1.2207440846 ** -np.arange(1.0, 4.0)  # of Roberts' sequence in three dimensions, modulo 1


@dataclass(frozen=True)
class TracedSheet(LightSheet):
    """A light sheet as bodies leave it.

    Parameters
    ----------
    corner_mm : (float, float)
        x and y of the left upper corner of the boxes.
    side_mm : float
        Of a box.
    sums : (array, array)
        Light, its first two moments by height, and the part of each box that is gas (4, rows, columns), at pulses
        A and B.
    """

    corner_mm: tuple[float, float] = (0.0, 0.0)
    side_mm: float = 1.0
    sums: tuple[Float64, Float64] = (np.zeros((4, 1, 1)), np.zeros((4, 1, 1)))

    @property
    def reach_mm(self) -> float:
        """Distance from the middle beyond which no light is counted."""
        return light_reach_mm(self)

    def light(self, points_mm: Float64, pulse: int) -> Float64:
        """Light (N,) of pulse 0 (A) or 1 (B) at points (N, 3), 1 in the middle of the first source's sheet."""
        x, y, z = points_mm.T
        places = np.array(((self.corner_mm[1] - y) / self.side_mm, (x - self.corner_mm[0]) / self.side_mm)) - 0.5
        light, first, second, gas = (
            scipy.ndimage.map_coordinates(moment, places, order=1, mode="nearest") for moment in self.sums[pulse]
        )
        usual, some = upright_mm(self), np.maximum(light, LEAST_LIGHT * self.side_mm**2)
        height = first / some
        thickness = np.maximum(4.0 * np.sqrt(np.maximum(second / some - height**2, 0.0)), THINNEST * usual)
        off = z - self.middle_mm(x, y) - (pulse - 0.5) * self.apart_mm - height
        bright = light / np.maximum(gas, LEAST_GAS) / self.side_mm**2 * usual / thickness
        return np.asarray(self.energies[pulse] * bright * np.exp(-8.0 * np.square(off / thickness)))


def light_reach_mm(sheet: LightSheet) -> float:
    """Distance from the middle within which light of a sheet is counted behind bodies."""
    return REACH * upright_mm(sheet) + 0.5 * abs(sheet.apart_mm)


def upright_mm(sheet: LightSheet) -> float:
    """Thickness of a sheet along z."""
    return float(sheet.thickness_mm * np.sqrt(1.0 + sheet.slope_x**2 + sheet.slope_y**2))


def trace_sheet(
    scene: Scene, sheet: LightSheet, sources: Sequence[SheetSource], corners_mm: Float64
) -> TracedSheet:
    """Trace a sheet through the bodies of a scene, for the area between two corners (2, 2), low and high."""
    low, high = corners_mm
    side = max(BOX * sheet.thickness_mm, float((high - low).max()) / MOST_BOXES)
    columns, rows = (int(np.ceil(length / side)) for length in high - low)
    raster = (float(low[0]), float(high[1])), side, (rows, columns)
    pulses = [replace(sheet, offset_mm=sheet.offset_mm + part * sheet.apart_mm) for part in (-0.5, 0.5)]
    balls = Sphere.among(scene.bodies)

    def lit(pulse: LightSheet) -> Float64:
        sums = count_light(scene, pulse, sources, raster, RAYS_PER_BOX / side)[0]
        return np.concatenate(
            (sums, gas_share(balls, pulse, raster, sums[1] / np.maximum(sums[0], LEAST_LIGHT))[None])
        )

    first, second = (lit(one) for one in pulses)
    return TracedSheet(**vars(sheet), corner_mm=raster[0], side_mm=side, sums=(first, second))


def gas_share(balls: Sequence[Sphere], sheet: LightSheet, raster: Raster, height_mm: Float64) -> Float64:
    """Part (rows, columns) of boxes outside of balls, at a height (rows, columns) over the plane of a sheet.

    A ball's edge counts as straight within a box: without this, light beside glass would be as much too faint.
    """
    (left, top), side, (rows, columns) = raster
    y, x = np.meshgrid(
        top - side * (np.arange(rows) + 0.5), left + side * (np.arange(columns) + 0.5), indexing="ij"
    )
    z = sheet.middle_mm(x, y) + height_mm
    share = np.ones(height_mm.shape)
    for ball in balls:
        across, along, up = ball.centre_mm
        section2 = ball.radius_mm**2 - np.square(z - up)
        beyond = np.hypot(x - across, y - along) - np.sqrt(np.maximum(section2, 0.0))
        share = np.where(section2 > 0.0, np.minimum(share, np.clip(0.5 + beyond / side, 0.0, 1.0)), share)
    return share


def count_light(
    scene: Scene,
    sheet: LightSheet,
    sources: Sequence[SheetSource],
    raster: Raster,
    rays_per_mm: float,
    seed: int = 0,
) -> tuple[Float64, Float64]:
    """Count the light of a sheet in boxes of its plane.

    Parameters
    ----------
    scene : Scene
        Its bodies; the plane of the sheet is where `sheet` has it.
    sheet, sources
        Thickness and plane, and where the light comes from.
    raster : ((float, float), float, (int, int))
        Left upper corner and side of the boxes [mm], rows and columns.
    rays_per_mm : float
        Of the width of each source.
    seed : int
        Where the sequences of heights, angles and places begin.

    Returns
    -------
    ndarray, ndarray
        Light and its first two moments by height (3, rows, columns); powers (3,) of all sources, of what left the
        bodies, and of what ended at opaque ones.

    Raises
    ------
    SceneError
        A body is of a kind that the renderer has no optics for.
    """
    (left, top), side, shape = raster
    edge = np.hypot(max(abs(left), abs(left + side * shape[1])), max(abs(top), abs(top - side * shape[0])))
    outlines = [body.capsule for body in scene.bodies]
    far = 1.0 + max([float(edge), *(float(np.abs(one[:2]).sum()) + one.radius_mm for one in outlines)])
    # every body is before it
    world = tables_of(scene, Pose((0.0, 0.0, -2.0 * far)), None, is_light=True).world
    boxes = (left, top, side, REACH * upright_mm(sheet), sheet.offset_mm, sheet.slope_x, sheet.slope_y)
    sums, powers = np.zeros((3, *shape)), np.zeros(3)
    rng = np.random.default_rng(seed)
    for source in sources:
        rays = _rays(source, sheet, far, 1 + int(rays_per_mm * source.width_mm), rng)
        leave_light(rays, world, boxes, sums, powers)
    return sums, powers


def _rays(source: SheetSource, sheet: LightSheet, far: float, count: int, rng: np.random.Generator) -> Float64:
    """Rays (count, 8) of a source as `leave_light` takes them."""
    share = (np.arange(count) + rng.random(count)) / count
    spread = np.clip((np.arange(count)[:, None] * STEPS + rng.random(3)) % 1.0, 1e-12, 1.0 - 1e-12)
    power, s = source.power * source.width_mm / count, source.width_mm * (share - 0.5)
    if source.gaussian:  # as bright in its middle as an even one
        power, s = power * np.sqrt(0.125 * np.pi), 0.25 * source.width_mm * scipy.special.ndtri(share)
    height = 0.25 * upright_mm(sheet) * scipy.special.ndtri(spread[:, 0])
    slope = np.tan(np.deg2rad(0.25 * source.divergence_deg)) * scipy.special.ndtri(spread[:, 1])
    angle = np.deg2rad(source.from_deg)
    along, across = -np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
    apex_mm = 0.5 * source.width_mm / np.tan(np.deg2rad(0.5 * source.fan_deg)) if source.fan_deg else np.inf
    ways = np.column_stack((along + (s / apex_mm)[:, None] * across, slope))
    places = np.column_stack((s[:, None] * across, height - slope * source.focus_mm))
    places -= min(far, 0.99 * apex_mm) * ways
    tilt = np.array([sheet.slope_x, sheet.slope_y])
    places[:, 2] += sheet.offset_mm + places[:, :2] @ tilt
    ways[:, 2] += ways[:, :2] @ tilt
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    return np.column_stack((places, ways, np.full(count, power), spread[:, 2]))
