"""Branches: which bodies a ray crosses, in which order, and on which way through each.

A branch is a tuple of event NAMES, such as ("upper", "lower core"); () is the direct view.  An event is one body
on one way through it, and has a number.  A branch has, for those who cannot carry names:

    events   its event numbers in order, as spheres stand in the scene's table (``tracer.kernels.branches``)
    key      a hash of the events that a ray makes as it goes, of any length; DIRECT for the direct view
    number   its place in a map's list of branches.  Known before a ray is traced where a scene is traced in
    lockstep:
             number k < 2^N means "of the N spheres from the highest centre down, those whose bit is set in k, in
             this order", whether or not a ray takes it.  Otherwise branches are numbered by length and name, so
             that the order of bodies in a file does not matter
    trip     the events of a lockstep ray in one integer, spheres counted from the highest centre down
    text     "upper > lower core", for people

The mirror image of a scene that is its own has another number for some branches: `mirror_numbers`.  All that
turns one of these into another stands here; kernels write keys and trips by ``tracer.kernels.branches``.
"""

from collections.abc import Sequence
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from tracer.bodies import Sphere
from tracer.kernels.branches import BITS, DIRECT, KEY_MASK, UNKNOWN, next_key
from tracer.scene.scene import Scene

Branch = tuple[str, ...]
Numbers = NDArray[np.uint16 | np.uint32]  # of branches, whichever is long enough
BETWEEN = " > "  # the names of a text
SHORT_NUMBERS = 1 << 16  # branches that uint16 can number; a packed bed seen by a whole sensor has more


class BranchList(Sequence[Branch]):
    """Branches as numbers, each named when it is asked for: a bed has a hundred thousand.

    Parameters
    ----------
    names : sequence of str
        Names of the events.
    events : (E,) int
        Events of all branches, one after the other.
    begin : (B + 1,) int
        Where each branch begins in `events`.
    """

    def __init__(
        self, names: Sequence[str], events: NDArray[np.integer[Any]], begin: NDArray[np.integer[Any]]
    ) -> None:
        self.names, self.events, self.begin = tuple(names), events, begin

    def __len__(self) -> int:
        return len(self.begin) - 1

    @overload
    def __getitem__(self, index: int) -> Branch: ...

    @overload
    def __getitem__(self, index: slice) -> tuple[Branch, ...]: ...

    def __getitem__(self, index: int | slice) -> Branch | tuple[Branch, ...]:
        places = range(len(self))[index]
        if isinstance(places, range):
            return tuple(self[place] for place in places)
        events = self.events[self.begin[places] : self.begin[places + 1]].tolist()
        return tuple([self.names[event] for event in events])

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Sequence) and tuple(self) == tuple(other)

    def __hash__(self) -> int:
        return hash(tuple(self))

    def __repr__(self) -> str:
        return f"BranchList({len(self)} branches)"


def lengths_of(branches: Sequence[Branch]) -> NDArray[np.int64]:
    """Bodies crossed on each branch (B,)."""
    if isinstance(branches, BranchList):
        return np.diff(branches.begin).astype(np.int64)
    return np.array([len(names) for names in branches], np.int64)


class EventNumbers(dict[str, int]):
    """Number of each event by its name; those of ways by faces are computed on demand."""

    def __init__(self, scene: Scene) -> None:
        super().__init__({name: event for event, name in enumerate(scene.event_names()) if name})
        self.scene = scene

    def __missing__(self, name: str) -> int:
        return self.scene.event_by_faces(name)


def event_numbers(scene: Scene) -> EventNumbers:
    """Number of each event by its name."""
    return EventNumbers(scene)


def sphere_of(scene: Scene, event: str) -> Sphere:
    """Return the sphere to which the name of an event belongs."""
    return scene.spheres[scene.event_names().index(event) % len(scene.spheres)]


def last_sphere(scene: Scene, branch: Branch) -> Sphere | None:
    """Return the sphere of a branch that is nearest the plane; None if it goes through walls alone."""
    spheres = {name: sphere for sphere in scene.spheres for name in sphere.event_names}
    return next((spheres[name] for name in reversed(branch) if name in spheres), None)


def key_of(events: NDArray[np.int64]) -> int:
    """Branch key of events."""
    key = DIRECT
    for event in events.tolist():
        key = next_key(key, event) & KEY_MASK
    return key


def number_in(branches: list[Branch], branch: Branch) -> int:
    """Place of a branch in a list, to which it is appended if it is not there."""
    if branch not in branches:
        branches.append(branch)
    return branches.index(branch)


def chain(scene: Scene) -> list[Sphere]:
    """Spheres as lockstep counts them: from the highest centre down."""
    return sorted(scene.spheres, key=lambda s: (-s.centre_mm[2], s.centre_mm, s.radius_mm))


def chain_branches(scene: Scene) -> list[Branch]:
    """Branches by lockstep's numbers, 2^N of them."""
    names = [sphere.name for sphere in chain(scene)]
    return [tuple(n for bit, n in enumerate(names) if mask >> bit & 1) for mask in range(1 << len(names))]


def chain_trip(scene: Scene, events: NDArray[np.int64]) -> int:
    """Trip of a lockstep ray with these events."""
    order, trip = chain(scene), 0
    for number in events.tolist():
        trip = trip << BITS | (order.index(scene.spheres[number]) + 1)
    return trip


def mirror_numbers(image: Sequence[int]) -> NDArray[np.int64]:
    """Lockstep's number of the mirror image of each branch, then UNKNOWN; empty if all stay what they are.

    `image` says which sphere of the chain is the mirror image of which.
    """
    if list(image) == sorted(image):
        return np.empty(0, np.int64)
    numbers = np.arange(1 << len(image))
    return np.append(sum((numbers >> k & 1) << other for k, other in enumerate(image)), UNKNOWN)


def text_of(branch: Branch) -> str:
    """Branch for people; '' is the direct view."""
    return BETWEEN.join(branch)


def branch_of(text: str) -> Branch:
    """Branch of a text that `text_of` made."""
    return tuple(text.split(BETWEEN)) if text else ()


__all__ = [
    "DIRECT",
    "Branch",
    "BranchList",
    "Numbers",
    "branch_of",
    "chain",
    "chain_branches",
    "chain_trip",
    "event_numbers",
    "key_of",
    "last_sphere",
    "lengths_of",
    "mirror_numbers",
    "number_in",
    "sphere_of",
    "text_of",
]
