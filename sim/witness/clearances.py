"""True clearances between camera, glass and target while they move.

Camera, glass and target are carried by axes; where one element is relative to another is the sum of what their
axes have moved since the place at which the scene file holds. For each pair of shapes the clearance (distance of
the surfaces, negative inside) is a function of that relative place and changes by no more than the place does.
So from one exact look a whole neighbourhood is known to be free, and the next exact look is needed only outside
it: that is what makes watching cheap.

Shapes are those of the bench file: bodies are capsules (a sphere is one without length), the camera is a capsule
along its axis, the target a box behind z = 0; a window is a raft of capsules as thick as it, a tube a ring of
them, a block lines across its faces, and what the bench carries stands. The scene is the file's: that a simulated
bench is built a few tenths of a millimetre off it is not held against the user of the file.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from itertools import combinations, pairwise
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

from sim.witness.distances import Point, along, least, plus, segment_to_box, segment_to_segment
from tracer.bodies import Block, Body, Box, Dome, Prism, Rod, Sphere, Tube, Window

if TYPE_CHECKING:  # names alone: a watcher without a scene does not wait for scipy and numba
    from daq.bench.keep_out import KeepOutTable
    from tracer.scene.scene import Scene

ELEMENTS = ("camera", "glass", "bench", "target")
LINES_MM = 2.0  # between lines on a face: 0.1 mm of a distance of 5 mm
CONTACT_MM = 0.025  # by which bodies named in `contact` may overlap the target, as docs/files.md says


class Carried(NamedTuple):
    """Element that an axis carries, index of the world direction, and its position where the scene file holds."""

    element: str
    direction: Literal[0, 1, 2]
    scene_at_mm: float


class Approach(NamedTuple):
    """Two shapes came too close."""

    one: str
    other: str
    clearance_mm: float
    allowed_mm: float


class _Capsule(NamedTuple):
    name: str
    begin: Point
    end: Point
    radius_mm: float


class _Box(NamedTuple):
    name: str
    low: Point
    high: Point


@dataclass
class _Pair:
    """Two shapes; `clearance_mm` takes where the first one's element is relative to the other one's."""

    one: str
    other: str
    allowed_mm: float
    clearance_mm: Callable[[Point], float]
    begun_mm: float = math.inf  # clearance at the beginning of the present motion


@dataclass
class _Elements:
    """All pairs of shapes of two elements, and how far these may still move relative to each other unseen."""

    pairs: list[_Pair]
    axes: dict[str, tuple[Literal[0, 1, 2], int, float]]  # direction, sense, and where the scene file holds
    slack_mm: float
    left_mm: float = -1.0
    is_moving: bool = False

    def place(self, at_mm: Mapping[str, float]) -> Point:
        """Place of the first element relative to the second."""
        place = [0.0, 0.0, 0.0]
        for axis, (direction, sense, scene_at_mm) in self.axes.items():
            place[direction] += sense * (at_mm[axis] - scene_at_mm)
        return (place[0], place[1], place[2])

    def look(self, place: Point) -> list[float]:
        """Return all clearances at a place; the least of them is free way from there."""
        clearances_mm = [pair.clearance_mm(place) for pair in self.pairs]
        self.left_mm = min(mm - pair.allowed_mm for pair, mm in zip(self.pairs, clearances_mm, strict=True))
        return clearances_mm

    def begin(self, at_mm: Mapping[str, float]) -> None:
        """Note what the clearances are when a motion begins; what is free need not be known closer."""
        self.is_moving = True
        clearances_mm = [math.inf] * len(self.pairs) if self.left_mm > 0.0 else self.look(self.place(at_mm))
        for pair, clearance_mm in zip(self.pairs, clearances_mm, strict=True):
            pair.begun_mm = clearance_mm


class Clearances:
    """Judges how elements move relative to each other.

    Parameters
    ----------
    scene : Scene
        Camera and bodies where every axis stands at its `scene_at_mm`.
    carried : mapping of str to Carried
        By axis.
    table : KeepOutTable
        Sizes and clearance.
    slack_mm : mapping of str to float
        How far each axis may truly be off, by axis.
    """

    def __init__(
        self, scene: "Scene", carried: Mapping[str, Carried], table: "KeepOutTable", slack_mm: Mapping[str, float]
    ) -> None:
        self._at_mm = {axis: what.scene_at_mm for axis, what in carried.items()}
        shapes = _shapes(scene, table)
        self._elements = []
        for one, other in combinations(ELEMENTS, 2):
            if shapes[one] and shapes[other]:
                axes = {
                    axis: (what.direction, 1 if what.element == one else -1, what.scene_at_mm)
                    for axis, what in carried.items()
                    if what.element in (one, other)
                }
                pairs = [_pair(a, b, table) for a in shapes[one] for b in shapes[other]]
                self._elements.append(_Elements(pairs, axes, _slack(axes, slack_mm)))
        self._of_axis = {axis: [two for two in self._elements if axis in two.axes] for axis in carried}

    def put(self, axis: str, at_mm: float) -> None:
        """Note where an axis is, without judging how it came there."""
        for two in self._of_axis[axis]:
            two.left_mm -= abs(at_mm - self._at_mm[axis])
        self._at_mm[axis] = at_mm

    def judge_motion(
        self, ends_mm: Mapping[str, float], watched: set[str], slipped_mm: Mapping[str, float]
    ) -> list[Approach]:
        """Judge a straight stretch of motion from where everything was; return what came too close.

        Parameters
        ----------
        ends_mm : mapping of str to float
            Where the axes that move come to.
        watched : set of str
            Those of them that have to keep clear; two elements are judged if one of these carries one of them.
        slipped_mm : mapping of str to float
            How far axes may be off besides, which no reading of the bench shows.
        """
        touched = {id(two): two for axis in ends_mm for two in self._of_axis[axis]}
        held = []
        for two in touched.values():
            if watched.isdisjoint(two.axes):
                two.is_moving = False  # what moves next begins where this has ended
                continue
            held.append(two)
            if not two.is_moving:
                two.begin(self._at_mm)
        begin_mm = {axis: self._at_mm[axis] for axis in ends_mm}
        for axis, at_mm in ends_mm.items():
            self.put(axis, at_mm)
        found: list[Approach] = []
        for two in held:
            if two.left_mm <= 0.0:
                begin, end = two.place(self._at_mm | begin_mm), two.place(self._at_mm)
                slack_mm = two.slack_mm + sum(mm for axis, mm in slipped_mm.items() if axis in two.axes)
                found += _too_close(two, begin, end, slack_mm)
        return found

    def note_rest(self) -> None:
        """Note that everything is at rest: what moves next begins anew."""
        for two in self._elements:
            two.is_moving = False


def _too_close(elements: _Elements, begin: Point, end: Point, slack_mm: float) -> Iterator[Approach]:
    way_mm = math.dist(begin, end)
    for pair, end_mm in zip(elements.pairs, elements.look(end), strict=True):
        allowed_mm = pair.allowed_mm - slack_mm
        if pair.begun_mm < allowed_mm:  # it may not come closer still
            allowed_mm = pair.begun_mm - slack_mm
        if end_mm - way_mm >= allowed_mm:
            continue
        closest_mm = least(partial(_between, pair, begin, end))
        if closest_mm < allowed_mm:
            yield Approach(pair.one, pair.other, closest_mm, allowed_mm)


def _between(pair: _Pair, begin: Point, end: Point, part: float) -> float:
    return pair.clearance_mm(along(begin, end, part))


def _shapes(scene: "Scene", table: "KeepOutTable") -> dict[str, list[_Capsule | _Box]]:
    x, y, z = scene.camera.position_mm
    fx, fy, fz = (float(component) for component in scene.camera.rotation_matrix[2])
    ahead, behind = table.camera_ahead_mm, table.camera_behind_mm
    camera = _Capsule(
        "the camera",
        (x - behind * fx, y - behind * fy, z - behind * fz),
        (x + ahead * fx, y + ahead * fy, z + ahead * fz),
        table.camera_radius_mm,
    )
    width, height, depth = table.target_size_mm
    target = _Box("the target", (-width / 2, -height / 2, -depth), (width / 2, height / 2, 0.0))
    shapes: dict[str, list[_Capsule | _Box]] = {"camera": [camera], "glass": [], "bench": [], "target": [target]}
    for body in scene.bodies:
        shapes[body.carried] += _capsules(body)
    return shapes


def _capsules(body: Body) -> list[_Capsule]:
    if type(body) not in CAPSULES:
        raise TypeError(f"the witness knows no distances to {body!r}; teach it")
    return CAPSULES[type(body)](body)


def _raft(window: Window) -> list[_Capsule]:
    """Capsules side by side in the middle of the plate, half as far apart as they are thick."""
    half_mm, (right, up) = 0.5 * window.thickness_mm, _square_to(window.normal)
    middle = plus(window.centre_mm, _times(-half_mm, window.normal))
    count = max(1, math.ceil(window.radius_mm / half_mm))
    found = []
    for number in range(-count, count + 1):
        off_mm = number * window.radius_mm / count
        reach_mm = math.sqrt(window.radius_mm**2 - off_mm**2)
        foot = plus(middle, _times(off_mm, up))
        ends = plus(foot, _times(-reach_mm, right)), plus(foot, _times(reach_mm, right))
        found.append(_Capsule(window.name, *ends, half_mm))
    return found


def _ring(tube: Tube) -> list[_Capsule]:
    """Capsules along the tube in the middle of its wall, half as far apart as they are thick."""
    half_mm, (right, up) = 0.5 * (tube.outer_radius_mm - tube.inner_radius_mm), _square_to(tube.axis)
    if tube.inner_radius_mm == 0.0:
        return [_Capsule(tube.name, tube.start_mm, tube.end_mm, tube.outer_radius_mm)]
    around_mm = tube.outer_radius_mm - half_mm
    count = math.ceil(2.0 * math.pi * around_mm / half_mm)
    found = []
    for number in range(count):
        angle = 2.0 * math.pi * number / count
        step = plus(_times(around_mm * math.cos(angle), right), _times(around_mm * math.sin(angle), up))
        found.append(_Capsule(tube.name, plus(tube.start_mm, step), plus(tube.end_mm, step), half_mm))
    return found


def _faces(block: Block) -> list[_Capsule]:
    """Lines across all faces of a block, LINES_MM apart at most, and along its edges.

    A face is cut at its first corner and the one opposite into two chains; a line joins points of the same share.
    """
    points = [(float(x), float(y), float(z)) for x, y, z in block.corners_mm]
    count = len(points) // 2
    back, front = points[:count], points[count:]
    rings = [[back[k - 1], back[k], front[k], front[k - 1]] for k in range(count)] + [back, front]
    found = []
    for ring in rings:
        middle = len(ring) // 2
        chains = ring[: middle + 1], [ring[0], *ring[: middle - 1 : -1]]
        length_mm = max(sum(math.dist(*step) for step in pairwise(chain)) for chain in chains)
        steps = max(2, math.ceil(length_mm / LINES_MM))
        ends = ([_on_chain(chain, step / steps) for step in range(steps + 1)] for chain in chains)
        found += [_Capsule(block.name, one, other, 0.0) for one, other in zip(*ends, strict=True)]
        found += [_Capsule(block.name, *step, 0.0) for step in pairwise((*ring, ring[0]))]
    return found


def _on_chain(chain: list[Point], share: float) -> Point:
    """Point of a chain of points at a share of its length."""
    left_mm = share * sum(math.dist(*step) for step in pairwise(chain))
    for one, other in pairwise(chain):
        length_mm = math.dist(one, other)
        if left_mm <= length_mm:
            return along(one, other, left_mm / length_mm)
        left_mm -= length_mm
    return chain[-1]


def _times(factor: float, vector: Point) -> Point:
    return (factor * vector[0], factor * vector[1], factor * vector[2])


def _square_to(way: Point) -> tuple[Point, Point]:
    """Two unit vectors at right angles to a unit vector and to each other."""
    x, y, z = way
    helper = (1.0, 0.0, 0.0) if abs(x) < 0.7 else (0.0, 1.0, 0.0)
    one = (y * helper[2] - z * helper[1], z * helper[0] - x * helper[2], x * helper[1] - y * helper[0])
    one = _times(1.0 / math.hypot(*one), one)
    return one, (y * one[2] - z * one[1], z * one[0] - x * one[2], x * one[1] - y * one[0])


def _pair(one: _Capsule | _Box, other: _Capsule | _Box, table: "KeepOutTable") -> _Pair:
    touches = {one.name, other.name} & set(table.contact) and isinstance(other, _Box)
    allowed_mm = -CONTACT_MM if touches else table.clearance_mm
    if isinstance(one, _Box):
        raise TypeError("a box stands second in every pair")
    if isinstance(other, _Box):
        box = other

        def to_box(place: Point) -> float:
            apart = segment_to_box(plus(one.begin, place), plus(one.end, place), box.low, box.high)
            return apart - one.radius_mm

        return _Pair(one.name, other.name, allowed_mm, to_box)
    capsule = other

    def to_capsule(place: Point) -> float:
        apart = segment_to_segment(plus(one.begin, place), plus(one.end, place), capsule.begin, capsule.end)
        return apart - one.radius_mm - capsule.radius_mm

    return _Pair(one.name, other.name, allowed_mm, to_capsule)


def _slack(axes: Mapping[str, tuple[int, int, float]], slack_mm: Mapping[str, float]) -> float:
    """Tolerance of two elements along the worst direction."""
    along_each = [0.0, 0.0, 0.0]
    for axis, (direction, _, _) in axes.items():
        along_each[direction] += slack_mm[axis]
    return max(along_each)


CAPSULES: dict[type[Body], Callable[[Any], list[_Capsule]]] = {
    Rod: lambda rod: [_Capsule(rod.name, rod.start_mm, rod.end_mm, rod.radius_mm)],
    Sphere: lambda ball: [_Capsule(ball.name, ball.centre_mm, ball.centre_mm, ball.radius_mm)],
    Dome: lambda dome: [_Capsule(dome.name, dome.centre_mm, dome.centre_mm, dome.outer_radius_mm)],
    Window: _raft,
    Tube: _ring,
    Box: _faces,
    Prism: _faces,
}
