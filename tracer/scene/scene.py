"""The scene: camera, bodies, ambient medium, wavelength.

The investigation plane is z = 0 and the camera looks at it from z > 0.  Bodies may touch each other and nothing
more: contact is legal, overlap is refused.  Spheres, tubes and domes may reach through the plane, which is seen in
the gas between them.  Bodies wholly behind the plane are legal and never seen.

A scene is a value: frozen, comparable, with a content hash over every number that changes a ray (names
and the order of the bodies do not).  The hash travels into every map and every corrected frame.
"""

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from ground.short_repr import short_repr
from tracer.bodies import CONTACT_TOL_MM, KINDS, Block, Body, Index, Sphere, vector3
from tracer.camera import Camera
from tracer.errors import SceneError, StaleMap
from tracer.kernels.block import DIGIT
from tracer.kernels.branches import FACE_EVENTS
from tracer.kernels.rooms import ONE_ROOM, WAYS, Rooms
from tracer.kernels.world import MOST_NUMBERS
from tracer.light_sheet import LightSheet
from tracer.masked import LEFT_OUT, MaskedPart
from tracer.media import LARGEST_INDEX, VACUUM, Medium, check_wavelength
from tracer.scene.rooms import Arrangement
from tracer.scene.view import sheet_problem

BETWEEN_FACES = "-"  # in the name of a way through a block
DEEPEST_CUT_MM = 1.0  # that a light sheet may run into a body which touches the target's plane


class SceneBound:
    """Result that was made from one scene and serves no other, with its `scene_hash`."""

    scene_hash: str
    noun: ClassVar[str] = "map"
    cure: ClassVar[str] = "trace the scene again"

    def check(self, scene: "Scene") -> None:
        """Refuse to serve another scene.

        Raises
        ------
        StaleMap
            The scene has other numbers than the one this was made from.
        """
        wanted = scene.content_hash()
        if self.scene_hash != wanted:
            raise StaleMap(f"the {self.noun} belongs to scene {self.scene_hash}, not to {wanted}; {self.cure}")


@short_repr
@dataclass(frozen=True)
class Scene:
    """Camera and bodies in front of the investigation plane z = 0.

    Parameters
    ----------
    camera : Camera
        The camera.
    bodies : tuple of Body
        Any order, any arrangement.
    wavelength_nm : float
        Vacuum wavelength at which every index is taken.
    ambient : Medium
        What fills the room between the bodies, outside of windows and tubes.
    sheet : LightSheet, optional
        Where particles are lit, as far as that was measured (`lit`).  No ray to the target depends on it, so the
        content hash does not; see `in_light_sheet`.
    cut_mm : float
        How far rods, windows and meshes may reach through the plane: not through the target's, a little through a
        light sheet.
    masked : tuple of MaskedPart
        Parts of the view that no map is to use.  Rays do not depend on them, so the content hash does not.
    light : LightSheet, optional
        Sheet that lights z = 0, with its sources, of a scene in its sheet (`in_light_sheet`); not in the hash.

    Raises
    ------
    SceneError
        Bodies overlap, one reaches through the plane that may not, the camera is inside one, n < 1, or two share
        a name.
    """

    camera: Camera
    bodies: tuple[Body, ...] = ()
    wavelength_nm: float = 532.0
    ambient: Medium = VACUUM
    sheet: LightSheet | None = None
    cut_mm: float = 0.0
    masked: tuple[MaskedPart, ...] = ()
    light: LightSheet | None = None

    def __post_init__(self) -> None:
        check_wavelength(self.wavelength_nm)
        problems = [*self._index_problems(), *self._place_problems(), *self._overlap_problems()]
        problems += self.arrangement.problems()
        if problems:
            raise SceneError(problems=problems)

    @property
    def n_ambient(self) -> float:
        """Index of the ambient medium at the scene's wavelength."""
        return self.ambient.n(self.wavelength_nm)

    @cached_property
    def seen(self) -> tuple[Body, ...]:
        """The bodies in front of the plane, in file order."""
        return tuple(body for body in self.bodies if body.highest_mm > CONTACT_TOL_MM)

    @cached_property
    def spheres(self) -> tuple[Sphere, ...]:
        """The spheres in front of the plane, in file order."""
        return Sphere.among(self.seen)

    @cached_property
    def spheres_in_plane(self) -> tuple[Sphere, ...]:
        """The spheres that reach through the plane, in file order."""
        return tuple(sphere for sphere in self.spheres if sphere.lowest_mm < -CONTACT_TOL_MM)

    def with_bodies(self, bodies: Sequence[Body]) -> "Scene":
        """Return the same scene with other bodies."""
        return replace(self, bodies=tuple(bodies))

    def bare(self) -> "Scene":
        """Return the scene without what is driven out of the view: balls, supports, walls that go with them."""
        return replace(self, bodies=tuple(body for body in self.bodies if body.stays), masked=self.left_out)

    @property
    def left_out(self) -> tuple[MaskedPart, ...]:
        """Masked parts of the frame, whatever stands there."""
        return tuple(part for part in self.masked if part.why == LEFT_OUT)

    def with_camera(self, camera: Camera) -> "Scene":
        """Return the same scene with another camera."""
        return replace(self, camera=camera)

    def coarser(self, times: int) -> "Scene":
        """Return the scene before a camera of the same view with pixels `times` times wider."""
        masked = tuple(part.coarser(times) for part in self.masked)
        return replace(self, camera=self.camera.coarser(times), masked=masked)

    @property
    def lit(self) -> LightSheet:
        """Light sheet: `sheet`, or z = 0 with the uncertainty of a sheet that was set up by eye."""
        return self.sheet or LightSheet()

    def in_light_sheet(self) -> "Scene":
        """Return the scene as particles are seen: moved so that the light sheet is z = 0; itself without a sheet.

        Raises
        ------
        SceneError
            The sheet runs through a body, or nothing can be seen in it: it lies in glass or behind the camera, or
            its light passes beside the view.
        """
        sheet = self.sheet
        if sheet is None:
            return self
        light = sheet if sheet.sources else None
        camera, bodies = self._in_sheet
        if problem := sheet_problem(camera, bodies, sheet):
            raise SceneError(problem)
        deep = [b for b in bodies if b.lowest_mm < -DEEPEST_CUT_MM and not b.may_cross_plane]
        cut = [b for b in deep if b.highest_mm > CONTACT_TOL_MM]
        if cut:
            names = ", ".join(f"{body.name!r} ({-body.lowest_mm:.3g} mm deep)" for body in cut)
            raise SceneError(
                f"the light sheet at z = {sheet.z_mm:g} mm runs through {names}; put the bodies where they stood"
                " while the sheet was on, or correct z_mm and the tilt of the sheet"
            )
        return replace(self, camera=camera, bodies=bodies, sheet=None, cut_mm=DEEPEST_CUT_MM, light=light)

    @property
    def unseen_sheet(self) -> str:
        """Reason why the camera can see nothing in the light sheet, as a sentence; empty if it may."""
        try:
            return "" if self.sheet is None else sheet_problem(*self._in_sheet, self.sheet)
        except SceneError as error:
            return str(error)

    @cached_property
    def _in_sheet(self) -> tuple[Camera, tuple[Body, ...]]:
        """Camera and bodies in the coordinates of the light sheet, which there is."""
        sheet, camera = self.lit, self.camera
        if sheet.is_target_plane:
            return camera, self.bodies
        position_mm = sheet.place(camera.position_mm)
        if not position_mm[2] > 0.0:
            raise SceneError(f"a light sheet at z = {sheet.z_mm:g} mm lies behind the camera; is z_mm right?")
        first, second, third = (vector3(row) for row in camera.rotation_matrix @ sheet.axes().T)
        moved = replace(camera, position_mm=position_mm, rotation=(first, second, third))
        return moved, tuple(body.moved(sheet.place) for body in self.bodies)

    def sphere_table(self) -> NDArray[np.float64]:
        """Spheres for the kernels: (N, 6 or more) float64, see `Sphere.table_of`."""
        return self._sphere_table.copy()

    @cached_property
    def _sphere_table(self) -> NDArray[np.float64]:
        return Sphere.table_of(self.spheres, self._index)

    def shapes(self) -> dict[int, NDArray[np.float64]]:
        """Number and shape (45,) [mm] of each sphere that is out of round (``tracer.harmonics``)."""
        return {number: one.shape_mm for number, one in enumerate(self.spheres) if one.shape_um}

    def other_tables(self, instead: Mapping[str, Body] | None = None) -> tuple[Any, ...]:
        """Bodies that are no spheres, for the kernels: a table of each kind in use (``tracer.kernels.world``).

        Parameters
        ----------
        instead : mapping, optional
            Name -> what stands in the place of that body, and need not fit in there: for a fit on its way.
        """
        return tuple(table for _, table in (self._others(instead) if instead else self._other_tables))

    @cached_property
    def _other_tables(self) -> tuple[tuple[int, Any], ...]:
        return tuple(self._others({}))

    def row_of(self, body: Body) -> NDArray[np.float64]:
        """Row (W,) of a body that is no sphere for the kernels, as it is or as it might be."""
        return np.array(type(body).table_of((body,), self._index).rows[0])

    @cached_property
    def others(self) -> tuple[Body, ...]:
        """The bodies in `other_tables`, in their order."""
        seen = self.seen
        return tuple(body for kind in KINDS[1:] for body in kind.among(seen))

    @cached_property
    def arrangement(self) -> Arrangement:
        """Walls, and what stands inside of which."""
        return Arrangement(self.bodies, self.camera.position_mm, self.ambient)

    def rooms(self) -> Rooms:
        """Rooms for the kernels."""
        return self._rooms

    @cached_property
    def _rooms(self) -> Rooms:
        if self.arrangement.is_one_room:
            return ONE_ROOM
        return self.arrangement.rooms(self.spheres, self.others, self.wavelength_nm)

    def event_names(self) -> list[str]:
        """Names of the events that rays number (``tracer.strategies.branches``); branches are made of them.

        Going in and out of a room has none, and is no part of a branch.
        """
        most_cores = max((len(sphere.cores) for sphere in self.spheres), default=0)
        names = [sphere.event_name(way) for way in range(2 * most_cores + 1) for sphere in self.spheres]
        return names + [name for body in self.others for name in _ways_of(body)]

    def event_name(self, event: int, names: Sequence[str]) -> str:
        """Name of an event, `names` being `event_names()`; faces of a block follow: "box front-back"."""
        if event < len(names):
            return names[event]
        before = len(names) - WAYS * len(self.others)
        other, code = (event - before) % FACE_EVENTS, (event - before) // FACE_EVENTS
        faces: list[str] = []
        while code:
            code, digit = divmod(code, DIGIT)
            faces.insert(0, self.others[other // WAYS].face_names[digit - 1])
        return f"{names[before + other]} {BETWEEN_FACES.join(faces)}"

    def event_by_faces(self, name: str) -> int:
        """Return the event of a name that `event_name` made of faces.

        Raises
        ------
        KeyError
            No body has such a way.
        """
        way, _, faces = name.rpartition(" ")
        names, code = self.event_names(), 0
        event = names.index(way) if way in names else -1
        other = (event - len(names)) // WAYS
        if event < len(names) - WAYS * len(self.others):
            raise KeyError(name)
        for face in faces.split(BETWEEN_FACES):
            if face not in self.others[other].face_names:
                raise KeyError(name)
            code = DIGIT * code + self.others[other].face_names.index(face) + 1
        return event + FACE_EVENTS * code

    def _others(self, instead: Mapping[str, Body]) -> Iterator[tuple[int, Any]]:
        """Place in KINDS and table of each kind in use but spheres."""
        seen = self.seen
        for place, kind in enumerate(KINDS[1:], start=1):
            if bodies := kind.among(seen):
                yield place, kind.table_of([instead.get(body.name, body) for body in bodies], self._index)

    def n_around(self, body: Body) -> float:
        """Index of the medium in the room where a body stands."""
        if self.arrangement.is_one_room:
            return self.n_ambient
        return self.arrangement.medium_in(self.arrangement.home_of(body)).n(self.wavelength_nm)

    def in_camera_room(self, body: Body) -> bool:
        """Return whether no wall stands between the camera and a body, which is then seen where it stands."""
        return self.arrangement.home_of(body) is self.arrangement.home_of_camera

    @property
    def _index(self) -> Index:
        if self.arrangement.is_one_room:
            nm, room = self.wavelength_nm, self.n_ambient
            return lambda body, medium: 1.0 if medium is None else medium.n(nm) / room
        return lambda body, medium: 1.0 if medium is None else medium.n(self.wavelength_nm) / self.n_around(body)

    def content_hash(self) -> str:
        """Hex digest (16 characters) of every number that changes a ray."""
        camera = self.camera
        numbers = [
            [*camera.position_mm, *np.ravel(camera.rotation), camera.focal_px, *camera.principal_px],
            [*map(float, camera.sensor_px), *camera.lens.terms(), self.n_ambient],
        ]
        numbers += sorted([0.0, *row] for row in self.sphere_table().tolist())
        shaped = [sphere for sphere in self.spheres if sphere.shape_um]
        numbers += sorted([-2.0, *sphere.centre_mm, *sphere.shape_um] for sphere in shaped)
        for place, table in self._other_tables:
            numbers += sorted([float(place), *_in_short(row)] for row in table.rows)
        rooms = self.rooms()
        if len(rooms.home):  # which is where follows from the numbers; what fills the rooms does not
            numbers.append([-1.0, *rooms.n.tolist()])
        text = "\n".join(" ".join((float(x) + 0.0).hex() for x in row) for row in numbers)
        return hashlib.sha256(text.encode()).hexdigest()[:16]

    def _index_problems(self) -> list[tuple[str, str]]:
        media = [("", "ambient", self.ambient)]
        media += [(body.name, who, medium) for body in self.bodies for who, medium in body.media]
        problems = []
        for name, who, medium in media:
            try:
                n = medium.n(self.wavelength_nm)
            except SceneError as error:
                problems.append((name, f"{who}: {error}"))
                continue
            if not 1.0 <= n <= LARGEST_INDEX:
                text = f"n = {n:g} at {self.wavelength_nm:g} nm is {'below 1' if n < 1.0 else 'no index'}"
                problems.append((name, f"{who}: {text}; give 1 to {LARGEST_INDEX:g}"))
        return problems

    def _place_problems(self) -> list[tuple[str, str]]:
        camera = np.array(self.camera.position_mm)
        names = [body.name for body in self.bodies]
        problems = [
            (name, f"two bodies are called {name!r}; give each its own name")
            for name in sorted({name for name in names if names.count(name) > 1})
        ]
        ways = {way: body.name for body in self.bodies for way in body.event_names[1:]}
        problems += [
            (name, f"body {name!r} is called like a way through {ways[name]!r}, which has a core; rename it")
            for name in sorted(set(names) & ways.keys())
        ]
        for body in self.bodies:
            if body.room is None and body.distance_mm(camera) <= 0.0:
                problems.append(
                    (body.name, f"the camera is inside body {body.name!r}; correct its place or size, or L_mm")
                )
            through = body.lowest_mm < -CONTACT_TOL_MM - self.cut_mm and body.highest_mm > CONTACT_TOL_MM
            if through and not body.may_cross_plane:
                text = f"body {body.name!r} reaches {-body.lowest_mm:.6g} mm through the investigation plane"
                problems.append((body.name, f"{text}; a {body.kind} may touch z = 0, not cross it; end it there"))
        return problems

    def _overlap_problems(self) -> list[tuple[str, str]]:
        spheres = Sphere.among(self.bodies)
        pairs: list[tuple[Body, Sphere]] = [*_near_pairs(spheres)]
        others = [body for kind in KINDS[1:] for body in kind.among(self.bodies) if body.room is None]
        pairs += [(body, sphere) for body in others for sphere in spheres]
        gaps: list[tuple[Body, Body, float]] = [(one, other, one.gap_to_ball_mm(other)) for one, other in pairs]
        gaps += [
            (one, other, _gap_mm(one, other)) for one, other in combinations(others, 2) if one.media or other.media
        ]
        deep = [pair for pair in gaps if pair[2] < -CONTACT_TOL_MM]
        if not deep:
            return []
        one, other, gap_mm = min(deep, key=lambda pair: pair[2])
        text = f"bodies {one.name!r} and {other.name!r} overlap by {-gap_mm:.6g} mm"
        if len(deep) > 1:
            text += f", the deepest of {len(deep)} overlapping pairs"
        return [(other.name, f"{text}; they may touch, not overlap")]


def _in_short(row: NDArray[np.float64]) -> list[float]:
    """Numbers of a row; those of a long one, a mesh, as 32 bytes."""
    if len(row) <= MOST_NUMBERS:
        return [float(number) for number in row]
    return [float(byte) for byte in hashlib.sha256((row + 0.0).tobytes()).digest()]


def _gap_mm(one: Body, other: Body) -> float:
    """Distance of two bodies, one of them taken for its capsule: the better of both bounds from below."""
    if isinstance(one, Block) and isinstance(other, Block):
        return one.gap_to_block_mm(other)
    gaps = []
    for exact, around in ((one, other.capsule), (other, one.capsule)):
        start, step = np.array(around.start_mm), np.array(around.end_mm) - np.array(around.start_mm)
        at = np.linspace(0.0, 1.0, 33)
        for _ in range(6):  # the distance to a convex body is convex along a line
            distances = exact.distance_mm(start + at[:, None] * step)
            nearest = int(np.argmin(distances))
            at = np.linspace(at[max(nearest - 1, 0)], at[min(nearest + 1, 32)], 33)
        gaps.append(float(distances.min()) - around.radius_mm)
    return max(gaps)


def _ways_of(body: Body) -> tuple[str, str, str, str]:
    """Names of the ways THROUGH, IN, OUT and OFF of a body that is no sphere; round ones have none IN and OUT."""
    through, off, into, out = (*body.event_names, "", "", "")[:4]
    return through, into, out, off


def _near_pairs(spheres: Sequence[Sphere]) -> list[tuple[Sphere, Sphere]]:
    """Pairs whose extents in x meet; sorting along x keeps a bed of a thousand spheres quick."""
    ordered = sorted(spheres, key=lambda s: s.centre_mm[0] - s.radius_mm - s.uneven_mm)
    pairs = []
    for index, one in enumerate(ordered):
        right = one.centre_mm[0] + one.radius_mm + one.uneven_mm
        for other in ordered[index + 1 :]:
            if other.centre_mm[0] - other.radius_mm - other.uneven_mm > right:
                break
            pairs.append((one, other))
    return pairs
