"""The room of each body, derived from the arrangement (``tracer.kernels.rooms``).

A window or a tube has a room; a body is in it if the wall leaves it wholly inside.  Rooms are nested like boxes:
of two that hold the same body one holds the wall of the other.  What a wall cuts, or what stands behind two
windows neither of which is behind the other, cannot be, and is said with its names.
"""

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from tracer.bodies import CONTACT_TOL_MM, Block, Body
from tracer.camera import Vector3
from tracer.kernels.branches import FIRST_OTHER, NOTHING
from tracer.kernels.rooms import ONE_ROOM, OUTERMOST, Rooms
from tracer.media import Medium


class Arrangement:
    """Walls of some bodies, and what stands inside of which.

    Parameters
    ----------
    bodies : sequence of Body
        All of them, each with its own name.
    camera_mm : (float, float, float)
        The pinhole.
    ambient : Medium
        What is outside of all walls.
    """

    def __init__(self, bodies: Sequence[Body], camera_mm: Vector3, ambient: Medium) -> None:
        self._bodies, self._camera_mm, self._ambient = tuple(bodies), camera_mm, ambient
        self._walls = tuple(body for body in bodies if body.room is not None)

    @property
    def is_one_room(self) -> bool:
        """Return whether there are no walls."""
        return not self._walls

    @cached_property
    def _gaps_mm(self) -> dict[tuple[str, str | None], tuple[float, float]]:
        """Distances of each body outside and inside of each wall, by their names; None is the camera."""
        gaps: dict[tuple[str, str | None], tuple[float, float]] = {}
        for wall in self._walls:
            assert wall.room is not None
            for body in self._bodies:
                if body.name != wall.name:
                    gaps[wall.name, body.name] = wall.room.gaps_mm(*body.outline_mm)
            gaps[wall.name, None] = wall.room.gaps_mm(np.array([self._camera_mm]), 0.0)
        return gaps

    def _around(self, name: str | None) -> list[Body]:
        """Walls around a body, or around the camera (None)."""
        return [
            wall
            for wall in self._walls
            if wall.name != name and self._gaps_mm[wall.name, name][1] >= -CONTACT_TOL_MM
        ]

    def _innermost(self, name: str | None) -> Body | None:
        return max(self._around(name), key=lambda wall: len(self._around(wall.name)), default=None)

    def home_of(self, body: Body) -> Body | None:
        """Return the wall of the room in which a body stands; None for the outermost room."""
        return self._innermost(body.name) if self._walls else None

    @property
    def home_of_camera(self) -> Body | None:
        """Wall of the room in which the camera stands; None for the outermost room."""
        return self._innermost(None)

    def medium_in(self, wall: Body | None) -> Medium:
        """Return what fills the room of a wall, None being the outermost."""
        while wall is not None:
            assert wall.room is not None
            if wall.room.medium is not None:
                return wall.room.medium
            wall = self._innermost(wall.name)
        return self._ambient

    def problems(self) -> list[tuple[str, str]]:
        """Return what cannot be: name of the body at fault, empty for the camera, and a sentence."""
        if not self._walls:
            return []
        found = []
        for wall in self._walls:
            outside, inside = self._gaps_mm[wall.name, None]
            if max(outside, inside) < -CONTACT_TOL_MM:
                text = f"the camera stands in the glass of {wall.name!r} or behind its edge; move one of them"
                found.append((wall.name, text))
            elif inside > outside and isinstance(wall, Block):
                text = f"the camera stands inside the hollow {wall.kind} {wall.name!r}; describe the wall that it"
                found.append((wall.name, f"{text} looks through as kind: window, or correct centre_mm and L_mm"))
            for body in self._bodies:
                if body.name == wall.name:
                    continue
                outside, inside = self._gaps_mm[wall.name, body.name]
                deep_mm = -max(outside, inside)
                if deep_mm > CONTACT_TOL_MM and not self._holds(body, wall):
                    text = f"{wall.kind} {wall.name!r} cuts body {body.name!r}, {deep_mm:.6g} mm deep"
                    found.append((body.name, f"{text}; it must stand wholly on one side"))
        for body in self._bodies:
            around = self._around(body.name)
            depths = sorted(len(self._around(wall.name)) for wall in around)
            if depths != list(range(len(around))):
                names = " and ".join(repr(wall.name) for wall in around)
                text = f"body {body.name!r} is in the rooms of {names}, none of which is in the other"
                found.append((body.name, f"{text}; let one stand wholly behind the other"))
        return found

    def _holds(self, one: Body, wall: Body) -> bool:
        """Return whether `wall` is in the room of `one` and cannot cut it: only planes go on beyond the plate."""
        assert wall.room is not None
        may = one.room is not None and (one.room.surrounds or wall.room.surrounds)
        return may and self._gaps_mm[one.name, wall.name][1] >= -CONTACT_TOL_MM

    def rooms(self, spheres: Sequence[Body], others: Sequence[Body], wavelength_nm: float) -> Rooms:
        """Rooms for the kernels, of spheres and other bodies in the order of their tables."""
        if not self._walls:
            return ONE_ROOM
        walls = [body for body in others if body.room is not None]
        number: dict[str | None, int] = {None: OUTERMOST} | {wall.name: k + 1 for k, wall in enumerate(walls)}

        def room_of(wall: Body | None) -> int:
            return number[None if wall is None else wall.name]

        index = [self.medium_in(wall).n(wavelength_nm) for wall in (None, *walls)]
        return Rooms(
            np.array([room_of(self.home_of(body)) for body in (*spheres, *others)], np.int32),
            np.array([number[body.name] if body.room is not None else -1 for body in others], np.int32),
            np.array([NOTHING, *(FIRST_OTHER - others.index(wall) for wall in walls)], np.int32),
            np.array(index) / index[0],
            room_of(self.home_of_camera),
        )
