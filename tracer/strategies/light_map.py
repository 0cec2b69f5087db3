"""The light of a sheet, traced through the bodies: how bright each place of its plane is, and at which height.

A scene as it stands in its sheet (`Scene.in_light_sheet`) is turned so that the light goes down: its source is
where the camera was, and a plane behind everything takes the place of the investigation plane.  The rays are then
those of every scene (``tracer.kernels.rays``), with the same bodies; what they leave on the plane is added up in
``tracer.kernels.light_map``.

Across the thickness the light is a Gaussian in height and, if it diverges, one in direction, independent at the
focus: the width then follows sigma^2 = sigma_0^2 + (sigma_angle distance)^2, as that of a beam does.  Heights are
taken at equal steps (the trapezoidal rule, which a Gaussian makes exact), directions at Gauss-Hermite nodes.

Brightness 1 is that of the first source alone, without bodies, in the middle of its sheet at the origin.  Light
further than REACH thicknesses from the plane counts as stray.  Reflected light is not followed: its share is known
(`LightMap.share_reflected`), its places are not.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ground.rows import run_parts
from ground.short_repr import short_repr
from tracer.bodies import vector3
from tracer.camera import Vector3
from tracer.errors import SceneError
from tracer.kernels.light_map import (
    ABSORBED,
    EMITTED,
    MOST_HALVINGS,
    PASSED_ON,
    PIECE,
    PIECES,
    Raster,
    light_layers,
)
from tracer.light_sheet import FARTHEST, LightSheet, SheetSource
from tracer.scene.scene import Scene
from tracer.strategies.trace import world_of

LAYERS, DIRECTIONS = 32, 3  # across the thickness: heights, and angles where the light diverges
DIVERGING_LAYERS = 16  # heights where it does: 99 % of the nodes within 0.2 % of 32
REACH = 2.0  # thicknesses either way that count as light in the plane
# Of the layers, each with nodes of its own: the sum has the same bits for any number of threads
PARTS = 4
STEP_NODES = 4.0  # between rays, before tubes are halved
TOLERANCE = 0.25  # nodes
LEAST_LIGHT = 1e-6  # brightness below which height and thickness mean nothing


@short_repr
@dataclass(frozen=True)
class LightMap:
    """Light on a raster of the sheet's plane.

    Parameters
    ----------
    brightness : (h, w) float64
        Fluence, integrated over the height, relative to the sheet without bodies.
    height_mm, thickness_mm : (h, w) float64
        Mean height of the light over the plane, and its full width at e^-2; NaN where there is none.
    emitted, passed, absorbed : float
        Powers of all sources, of what left the bodies at last and of what opaque bodies took, in mm of a sheet of
        brightness 1.
    """

    brightness: NDArray[np.float64]
    height_mm: NDArray[np.float64]
    thickness_mm: NDArray[np.float64]
    emitted: float
    passed: float
    absorbed: float

    @property
    def share_reflected(self) -> float:
        """Share of the light that surfaces reflected, once or more, and that was not followed."""
        return 1.0 - (self.passed + self.absorbed) / self.emitted


def trace_light(
    scene: Scene, sheet: LightSheet, origin_mm: tuple[float, float], pitch_mm: float, shape: tuple[int, int]
) -> LightMap:
    """Trace the light of a sheet to nodes (row, column) of its plane at (x0 + column pitch, y0 - row pitch).

    Parameters
    ----------
    scene : Scene
        As it stands in the sheet, see `Scene.in_light_sheet`.
    sheet : LightSheet
        Its sources and thickness.
    origin_mm, pitch_mm, shape
        The nodes.

    Raises
    ------
    SceneError
        No light reaches them, or a source stands inside a body.
    """
    if not sheet.sources or sheet.thickness_mm is None:
        raise SceneError("the light sheet has no source; give its sources and thickness_mm")
    corner = np.array(origin_mm) + pitch_mm * (np.array([shape[1], -shape[0]]) - (1.0, -1.0))
    middle, radius = 0.5 * (corner + origin_mm), 0.5 * float(np.hypot(*(corner - origin_mm)))
    nodes, powers = np.zeros((3, *shape)), np.zeros(3)
    for source in sheet.sources:
        beam = _Beam(scene, source, vector3((*middle, 0.0)), radius + 2.0 * pitch_mm)
        for lit, power in _lit_parts(beam, sheet.thickness_mm, (origin_mm, pitch_mm, shape)):
            nodes += source.power * lit
            powers += source.power * power
    brightness = nodes[0] / pitch_mm**2
    if not brightness.max() > LEAST_LIGHT:
        raise SceneError("no light of the sheet reaches the view: opaque bodies or glass take all of it")
    weight = np.where(nodes[0] > LEAST_LIGHT * pitch_mm**2, nodes[0], np.nan)
    height = nodes[1] / weight
    thickness = 4.0 * np.sqrt(np.maximum(nodes[2] / weight - height**2, 0.0))
    emitted, passed, absorbed = (float(powers[k]) for k in (EMITTED, PASSED_ON, ABSORBED))
    return LightMap(brightness, height, thickness, emitted, passed, absorbed)


class _Beam:
    """Light of one source, and the scene turned so that it goes down z.

    Parameters
    ----------
    scene, source
        In the sheet.
    middle_mm : three floats
        Middle of the view.
    radius_mm : float
        Of the circle around the view.
    """

    def __init__(self, scene: Scene, source: SheetSource, middle_mm: Vector3, radius_mm: float) -> None:
        self.source = source
        comes = source.comes_from
        self.axes = np.array([np.cross((0.0, 0.0, 1.0), comes), (0.0, 0.0, 1.0), comes])  # x, y, z of the light
        ends = [np.array([b.capsule.start_mm, b.capsule.end_mm]) @ self.axes.T for b in scene.bodies]
        radii = [body.capsule.radius_mm for body in scene.bodies]
        far = [np.linalg.norm(end, axis=1).max() + radius for end, radius in zip(ends, radii, strict=True)]
        self.far = 1.0 + max([radius_mm + float(np.linalg.norm(middle_mm)), *far])
        self.back = 2.0 * self.far if not source.bend_per_mm else min(2.0 * self.far, 0.999 / source.bend_per_mm)
        self.floor = 2.0 * self.far  # the origin stands so high over the plane behind everything
        camera = replace(
            scene.camera,
            position_mm=(0.0, 0.0, self.floor + self.back),
            rotation=((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0)),
        )
        bodies = tuple(body.moved(self._place) for body in scene.bodies)
        self.scene = Scene(camera, bodies, scene.wavelength_nm, scene.ambient)

    def _place(self, point_mm: Vector3) -> Vector3:
        return vector3(self.axes @ np.array(point_mm) + (0.0, 0.0, self.floor))

    def layers(self, thickness_mm: float) -> NDArray[np.float64]:
        """Height at the focus, slope and weight (N, 3) of each layer, one in sum."""
        diverges = self.source.divergence_deg > 0.0
        step = np.linspace(-FARTHEST, FARTHEST, DIVERGING_LAYERS if diverges else LAYERS)
        angle, share = np.zeros(1), np.ones(1)
        if diverges:
            angle, share = np.polynomial.hermite_e.hermegauss(DIRECTIONS)
        weight = np.exp(-0.5 * step**2)[:, None] * share
        sigma, slope = 0.25 * thickness_mm, np.tan(0.25 * np.deg2rad(self.source.divergence_deg))
        heights, slopes = np.broadcast_arrays((sigma * step)[:, None], slope * angle)
        return np.stack((heights.ravel(), slopes.ravel(), (weight / weight.sum()).ravel()), axis=-1)


def _lit_parts(
    beam: _Beam, thickness_mm: float, raster: tuple[tuple[float, float], float, tuple[int, int]]
) -> Iterator[tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Nodes (3, h, w) and powers (3,) that parts of the layers add."""
    (x0, y0), pitch, shape = raster
    x, z = beam.axes[0], beam.axes[2]
    frame = np.array(
        [-x0 - beam.floor * z[0], x[0], z[0], y0 + beam.floor * z[1], -x[1], -z[1]]
    ) / pitch  # fmt: skip
    kernel_raster = Raster(frame, REACH * thickness_mm, beam.far, beam.floor, TOLERANCE * pitch)
    bend = beam.source.bend_per_mm
    narrow = (4.0 / beam.source.width_mm) ** 2 if beam.source.gaussian else 0.0
    source = np.array([beam.back, bend, beam.source.focus_mm, narrow])
    half = beam.source.half_mm
    places = np.linspace(-half, half, max(2, int(np.ceil(2.0 * half / (STEP_NODES * pitch))) + 1))
    layers, world = beam.layers(thickness_mm), world_of(beam.scene)
    parts = [(np.zeros((3, *shape)), np.zeros(3), layers[k::PARTS]) for k in range(PARTS)]

    def work(part: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]) -> None:
        nodes, powers, own = part
        scratch = np.zeros((MOST_HALVINGS + 3, PIECES, PIECE))
        own = np.ascontiguousarray(own)
        light_layers(own, places, source, world, kernel_raster, scratch, (nodes, powers))

    run_parts(work, parts)
    return ((nodes, powers) for nodes, powers, _ in parts)
