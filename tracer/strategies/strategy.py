"""Choice of how the rays of a scene are traced, made once, for ray map and inversion.

Every scene is traced by the fastest kind that supports it:

    lockstep   blocks of neighbouring pixels together, body by body: a few solid transparent spheres, none of lower
               refractive index than its surroundings, behind windows or not
    occluders  the same beside opaque rods; pixels whose ray may meet a rod are traced ray by ray
    bundles    blocks of pixels, each through the spheres near it: any number of solid or opaque spheres, behind
               windows or not; also spheres that the investigation plane cuts
    rays       pixel by pixel, everything else (supports, hollow balls, tubes, meshes ...)

All give the same map to rounding, which tests compare.  To add a method, add a kind, its requirements in `choose`
and its call in `Strategy.trace`; see ``docs/adr/0032-one-choice-of-strategy.md``.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ground.rows import run_rows
from tracer.bodies.rod import Rods
from tracer.bodies.window import Windows
from tracer.kernels.chain import BALL
from tracer.kernels.rays import MAX_EVENTS, trace_rows
from tracer.kernels.rooms import OUTERMOST
from tracer.kernels.sphere import OPAQUE, REFRACTIVE_INDEX, SOLID
from tracer.kernels.window import BEHIND, GLASS
from tracer.kernels.world import World
from tracer.scene.scene import Scene
from tracer.strategies.beds import Balls, trace_bed
from tracer.strategies.branches import Branch, Numbers
from tracer.strategies.lockstep import MAX_CHAIN, NO_WINDOWS, pack_chain, trace_lockstep
from tracer.strategies.occluders import trace_with_occluders
from tracer.strategies.trace import number_keys, pack_camera, world_of

# Of a ray in front of a window, 83 degrees from its normal: beyond, closed forms lose digits
MIN_COSINE = 0.12
# Of a ray in the glass and behind it (69.7 degrees): margin before total reflection
MIN_SQUARED_COSINE = 0.12
# Height over the plane where a ray enters, in thicknesses: its path is at most 1/sqrt(0.12) = 2.9
CLEARANCE = 3.0
NO_CHAIN = np.empty((0, BALL))


class Kind(StrEnum):
    """Methods of tracing a whole sensor, see the top."""

    LOCKSTEP = "lockstep"
    OCCLUDERS = "occluders"
    BUNDLES = "bundles"
    RAYS = "rays"


@dataclass(frozen=True, eq=False)
class Strategy:
    """Method of tracing one scene, forward and inverse.

    Parameters
    ----------
    scene : Scene
        The scene.
    kind : Kind
        Method of the ray map (pixel to plane).
    windows : (K, 10) float64
        Windows that stand in front of all spheres, from the camera on; none where walls stand otherwise.
    in_blocks : bool
        True if the inverse may solve nodes behind spheres and `windows` in blocks: there are no other walls, and
        every ray enters each window above the plane and not too obliquely (`is_usual`).
    """

    scene: Scene
    kind: Kind
    windows: NDArray[np.float64]
    in_blocks: bool

    @cached_property
    def camera(self) -> NDArray[np.float64]:
        """Camera for the kernels (20,)."""
        return pack_camera(self.scene.camera)

    @cached_property
    def world(self) -> World:
        """Bodies for the kernels."""
        return world_of(self.scene)

    @property
    def inverse_kind(self) -> Kind:
        """Method of the inverse (node to pixel): `kind` if nodes are solved in blocks without rods, else RAYS."""
        # Lockstep knows no rods.  Forward, the pixels whose ray may meet a rod are traced again with it
        # (`trace_with_occluders`).  In the inverse the ray changes with every Newton step, so beside rods all
        # bodies are tested in each step.
        return self.kind if self.in_blocks and self.kind is not Kind.OCCLUDERS else Kind.RAYS

    @cached_property
    def chain(self) -> NDArray[np.float64]:
        """Spheres (N, BALL) from the highest down if the inverse is solved in lockstep; else empty."""
        return pack_chain(self.scene) if self.inverse_kind is Kind.LOCKSTEP else NO_CHAIN

    @cached_property
    def balls(self) -> Balls:
        """Solid spheres as bundles take them."""
        return Balls(self.scene.sphere_table())

    @property
    def single_window(self) -> NDArray[np.float64] | None:
        """The only window (10,) before spheres in lockstep, if the index before it is the lowest; else None."""
        if self.inverse_kind is not Kind.LOCKSTEP or len(self.windows) != 1:
            return None
        return self.windows[0] if self.windows[0, [GLASS, BEHIND]].min() >= 1.0 else None

    def trace(
        self,
        plane: NDArray[np.float64 | np.float32],
        status: NDArray[np.uint8],
        branch: Numbers,
        most: int = MAX_EVENTS,
    ) -> tuple[Numbers, Sequence[Branch]]:
        """Trace every pixel of the sensor.

        Parameters
        ----------
        plane, status, branch : arrays (H, W, 2), (H, W), (H, W)
            Output; `branch` only if its integers are wide enough.
        most : int
            Largest number of bodies that a ray needs to be followed through.

        Returns
        -------
        tuple
            Branch numbers (H, W), in `branch` if they fit, and the branches.
        """
        if self.kind is Kind.LOCKSTEP:
            return branch, trace_lockstep(self.scene, plane, status, branch, windows=self.windows)
        if self.kind is Kind.OCCLUDERS:
            return branch, trace_with_occluders(self.scene, self.scene.other_tables()[0], plane, status, branch)
        if self.kind is Kind.BUNDLES:
            traced = trace_bed(self.scene, plane, status, branch, most, self.windows)
            if traced is not None:
                return traced
        key = np.empty(status.shape, np.int64)
        run_rows(
            lambda first, last: trace_rows(self.camera, self.world, first, last, plane, status, key), len(status)
        )
        return number_keys(self.scene, key)


def choose(scene: Scene) -> Strategy:
    """Choose how a scene is traced.

    Parameters
    ----------
    scene : Scene
        The scene.

    Returns
    -------
    Strategy
        The fastest one that supports it.
    """
    spheres, windows = scene.sphere_table(), windows_before(scene)
    kind, rods = Kind.RAYS, [type(table) for table in scene.other_tables()] == [Rods]
    if (windows is not None or rods) and spheres.shape[1] == SOLID and not scene.shapes():
        clear = not spheres[:, OPAQUE].any() and bool((spheres[:, REFRACTIVE_INDEX] >= 1.0).all())
        few = clear and len(spheres) <= MAX_CHAIN and not scene.spheres_in_plane
        kind = (Kind.LOCKSTEP if few else Kind.BUNDLES) if not rods else Kind.OCCLUDERS if few else Kind.RAYS
    open_room = scene.arrangement.is_one_room
    in_blocks = open_room or (windows is not None and is_usual(scene, windows))
    return Strategy(scene, kind, NO_WINDOWS if windows is None else windows, in_blocks)


def windows_before(scene: Scene) -> NDArray[np.float64] | None:
    """Rows (K, 10) of the windows from the camera on, if all spheres stand behind all of them; else None."""
    tables = scene.other_tables()
    if not tables:
        return NO_WINDOWS
    if len(tables) != 1 or not isinstance(tables[0], Windows):
        return None
    spheres = len(scene.sphere_table())
    rooms, rows = scene.rooms(), tables[0].rows
    room, order, homes = rooms.first, [], rooms.home[spheres:]
    while len(here := np.flatnonzero(homes == room)) == 1:
        order.append(int(here[0]))
        room = int(rooms.inside[here[0]])
    if rooms.first != OUTERMOST or len(order) != len(rows) or (rooms.home[:spheres] != room).any():
        return None
    return np.asarray(rows[order])


def is_usual(scene: Scene, windows: NDArray[np.float64]) -> bool:
    """Return whether every ray enters each window (K, 10) above the plane and not too obliquely.

    Tested on a grid of 65 x 65 pixels; the limits leave a margin for those between.
    """
    width, height = scene.camera.sensor_px
    pixels = np.stack(np.meshgrid(np.linspace(0, width - 1, 65), np.linspace(0, height - 1, 65)), axis=-1)
    ray, place = scene.camera.directions(pixels), np.array(scene.camera.position_mm)
    for row in windows:
        normal, n, behind = row[3:6], row[7], row[8]
        slope = -(ray @ normal)
        entry = place + (((place - row[:3]) @ normal) / slope)[..., None] * ray
        squared = 1.0 - (1.0 - slope**2) / np.array((n, behind))[:, None, None] ** 2  # by Snell
        if not (
            slope.min() > MIN_COSINE
            and squared.min() > MIN_SQUARED_COSINE
            and entry[..., 2].min() > CLEARANCE * row[6]
        ):
            return False
        # behind the window, in closed form (``tracer.kernels.windowed``), for the next one
        ray = (ray + (slope - np.sqrt(behind**2 - 1.0 + slope**2))[..., None] * normal) / behind
        place = entry - row[6] * normal
    return True
