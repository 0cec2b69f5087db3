"""Nothing may touch: ways are judged by what they bring together, before they are driven.

Three elements move rigidly on the bench: the camera, the glass (every body of the scene but walls) and the target.
Windows and tubes stand, unless the scene file says that glass or camera carry them. For the judgement all are
simple convex shapes:

* a body is a capsule: all points within a radius of a segment (a sphere is one without length); a window is a
  plate, a tube is many planks around a free inside (`tracer.bodies.Body.pieces`),
* the camera is a capsule along its axis, `camera_behind_mm` behind the pinhole to `camera_ahead_mm` before it,
* the target is a box of `target_size_mm` whose front face lies in the plane z = 0 of the scene.

On every piece of a way one axis moves and the rest stand still. The closest approach of two such shapes on a
straight piece is a least-squares problem with bounds: minimise

    | p0 + u e_p + s d  -  (q0 + sum v_i e_i) |    over 0 <= u, s, v_i <= 1,

u and v running over segment and box, s over the piece. It is convex, so its solution is the closest approach of
the whole piece and not of samples of it.

A piece is refused if it comes closer than the clearance; if it begins closer, if it comes closer still. Bodies
named in `contact` may touch the target: for them CONTACT_MM of overlap is allowed, which is what two axes may
be off. Homing is not judged, because no position is known yet.
"""

from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
import scipy
from numpy.typing import NDArray
from pydantic import Field

from ground.config import Table
from ground.usual import Usual
from stages.errors import Obstructed, StageUsageError
from stages.way import Piece
from tracer.bodies import Room
from tracer.scene.scene import Scene

CONTACT_MM = 0.025
ROUNDING_MM = 1e-6
WAY_OUT = (
    ". They are {:.2f} mm apart already: move one of them away first; if it is the homed place that obstructs, "
    "write the way out as stages: after_home"
)

Element = Literal["camera", "glass", "target", "bench"]
Vector = NDArray[np.float64]
Length = Annotated[float, Field(ge=0.0, le=1e4)]
AXES = np.eye(3)


class KeepOutTable(Table):
    """The ``keep_out:`` part of a bench file."""

    clearance_mm: Annotated[Annotated[float, Field(gt=0.0, le=1000.0)], Usual(0.4, 15.0)]
    target_size_mm: Annotated[list[Length], Field(min_length=3, max_length=3)]  # x, y, and z behind the plane
    camera_radius_mm: Length
    camera_ahead_mm: Length  # the lens, from the pinhole towards the target
    camera_behind_mm: Length
    contact: list[str] = Field(default_factory=list)  # bodies that may touch the target


@dataclass(frozen=True)
class Carrier:
    """Element that an axis moves, its world direction, and the position at which the scene file holds."""

    element: Element
    along: Literal["x", "y", "z"]
    scene_at_mm: float = 0.0


@dataclass(frozen=True)
class _Shape:
    """Points start + sum v_i edges_i for 0 <= v_i <= 1, grown by a radius; at the scene's positions."""

    element: Element
    name: str
    start_mm: Vector  # (3,)
    edges_mm: Vector  # (n, 3)
    radius_mm: float


class KeepOut:
    """Guard of a stage.

    Parameters
    ----------
    scene : Scene
        Camera and bodies where every axis stands at its `scene_at_mm`.
    carriers : mapping of str to Carrier
        Every axis of the stage.
    table : KeepOutTable
        Sizes and clearance.

    Raises
    ------
    StageUsageError
        A body that may touch the target is not in the scene, or camera or target stand in a wall.
    """

    def __init__(self, scene: Scene, carriers: Mapping[str, Carrier], table: KeepOutTable) -> None:
        self._carriers = dict(carriers)
        self._table = table
        if unknown := set(table.contact) - {body.name for body in scene.bodies}:
            raise StageUsageError(f"keep_out: there is no body {', '.join(sorted(unknown))} in the scene")
        forward = scene.camera.rotation_matrix[2]
        pinhole = np.array(scene.camera.position_mm)
        width, height, depth = table.target_size_mm
        self._shapes = [
            _Shape(
                "camera",
                "the camera",
                pinhole - table.camera_behind_mm * forward,
                np.array([(table.camera_ahead_mm + table.camera_behind_mm) * forward]),
                table.camera_radius_mm,
            ),
            _Shape(
                "target",
                "the target",
                np.array([-width / 2, -height / 2, -depth]),
                np.diag([width, height, depth]),
                0.0,
            ),
        ]
        for body in scene.bodies:
            self._shapes += [
                _Shape(body.carried, body.name, piece.start_mm, piece.edges_mm, piece.radius_mm)
                for piece in body.pieces
            ]
        walls = {body.name for body in scene.bodies if body.room is not None}
        holding = {body.name for body in scene.bodies if body.room and _holds(body.room, pinhole)}
        if walls - holding:
            self._refuse_cut(walls - holding)

    def _refuse_cut(self, walls: Set[str]) -> None:
        """Refuse sizes by which camera or target stand in one of some walls."""
        for one, wall, deep_mm in self.overlaps():
            if wall in walls:
                raise StageUsageError(
                    f"keep_out: at the positions of the scene file {one} is {deep_mm:.2f} mm deep in"
                    f" {wall!r}; correct the sizes in keep_out, or the scene"
                )

    def overlaps(self) -> Iterator[tuple[str, str, float]]:
        """Yield what camera or target stand in where the scene file holds: two names, and how deep [mm]."""
        for number, one in enumerate(self._shapes[:2]):
            for other in self._shapes[number + 1 :]:
                gap, radii = one.start_mm - other.start_mm, one.radius_mm + other.radius_mm
                if _at_least(gap, one.edges_mm, other.edges_mm) >= radii:
                    continue
                deep_mm = radii - _distance(gap, one.edges_mm, other.edges_mm)
                if deep_mm > CONTACT_MM:
                    yield one.name, other.name, deep_mm

    def check(self, way: Sequence[Piece]) -> None:
        """Raise if a way brings shapes too close.

        Raises
        ------
        Obstructed
            It does; the message names the pair, the distance and the piece.
        """
        for piece in way:
            for one, other, closest_mm, begin_mm in self._approaches(piece, self._table.clearance_mm):
                allowed_mm = self._limit_mm(one, other)
                if closest_mm < min(allowed_mm, begin_mm) - ROUNDING_MM:
                    text = (
                        f"{piece.axis} from {piece.start_mm:g} to {piece.end_mm:g} mm would bring {one.name} to "
                        f"{closest_mm:.2f} mm from {other.name}; allowed are {allowed_mm:g} mm"
                    )
                    raise Obstructed(text + (WAY_OUT.format(begin_mm) if begin_mm < allowed_mm else ""))

    def closest_mm(self, way: Sequence[Piece]) -> float:
        """Smallest distance between any two elements of which one moves, over a whole way."""
        return min((closest for piece in way for _, _, closest, _ in self._approaches(piece)), default=np.inf)

    def _limit_mm(self, one: _Shape, other: _Shape) -> float:
        elements = {one.element, other.element}
        if "target" in elements and {one.name, other.name} & set(self._table.contact):
            return -CONTACT_MM
        return self._table.clearance_mm

    def _approaches(self, piece: Piece, within_mm: float = np.inf) -> list[tuple[_Shape, _Shape, float, float]]:
        """Every pair of which one moves: closest distance on the piece, and distance at its beginning.

        Pairs that come no closer than `within_mm` are left out, most without solving for their distance.
        """
        carrier = self._carriers[piece.axis]
        here = {name: np.zeros(3) for name in ("camera", "glass", "target", "bench")}
        for name, at_mm in {**piece.others_mm, piece.axis: piece.start_mm}.items():
            other = self._carriers[name]
            here[other.element] = here[other.element] + (at_mm - other.scene_at_mm) * _direction(other.along)
        sweep = (piece.end_mm - piece.start_mm) * _direction(carrier.along)
        found = []
        for moved in (shape for shape in self._shapes if shape.element == carrier.element):
            for still in (shape for shape in self._shapes if shape.element != carrier.element):
                gap = moved.start_mm + here[moved.element] - still.start_mm - here[still.element]
                radii = moved.radius_mm + still.radius_mm
                swept = np.vstack([moved.edges_mm, sweep])
                if _at_least(gap, swept, still.edges_mm) - radii >= within_mm:
                    continue
                closest_mm = _distance(gap, swept, still.edges_mm) - radii
                if closest_mm < within_mm:
                    begin_mm = _distance(gap, moved.edges_mm, still.edges_mm) - radii
                    found.append((moved, still, closest_mm, begin_mm))
        return found


def _holds(room: Room, point_mm: Vector) -> bool:
    """Return whether a point is in a room that is closed around it: a camera looks out of its dome."""
    return room.surrounds and room.gaps_mm(point_mm[None], 0.0)[1] >= 0.0


def _direction(along: str) -> Vector:
    return np.array([float(name == along) for name in "xyz"])


def _at_least(gap: Vector, plus: Vector, minus: Vector) -> float:
    """No `_distance` is shorter: two things are apart by no less than their shadows on any line.

    The lines are the axes, which bench and board follow, and the one between where the two begin.
    """
    lines = np.vstack([gap / (np.linalg.norm(gap) or 1.0), AXES, -AXES])
    edges = np.vstack([plus, -minus])
    return float((lines @ gap + np.minimum(lines @ edges.T, 0.0).sum(axis=1)).max())


def _distance(gap: Vector, plus: Vector, minus: Vector) -> float:
    """Smallest length of gap + sum u_i plus_i - sum v_j minus_j with all coefficients between 0 and 1."""
    columns = np.vstack([plus, -minus])
    columns = columns[np.any(columns != 0.0, axis=1)]
    if not len(columns):
        return float(np.linalg.norm(gap))
    solution = scipy.optimize.lsq_linear(columns.T, -gap, bounds=(0.0, 1.0), method="bvls", tol=1e-12)
    return float(np.linalg.norm(columns.T @ solution.x + gap))
