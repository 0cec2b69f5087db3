"""Best distance of balls from the plane, and other changes that would show more of a scene.

Next to the focus of a ball, or of three in a row, its whole view shows a point of the plane, however good the
correction is; farther off it shows more and more of what it hides.  So distances are tried, in parts of a ball's
diameter, by maps of few pixels; of those that show nearly as much as the best the nearest is taken, because blur
and noise grow with it.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import TypeVar

from daq.errors import RunUsageError
from rtpiv.analysis.gaps import Gaps
from rtpiv.analysis.through_glass import ThroughGlass, coarse_share, percent
from rtpiv.templates.arrangement import AIR_MM, ARRANGEMENTS, BEDS, most_balls
from rtpiv.templates.files import scene_of
from rtpiv.templates.lab import Lab
from tracer.bodies import Body, Sphere
from tracer.errors import SceneError
from tracer.scene.scene import Scene

Found = TypeVar("Found")

PARTS = (0.1, 0.25, 0.5, 0.75, 1.0)  # of a diameter: distances between the plane and the glass
NEARLY = 0.05  # of what is hidden: no reason to go farther
LITTLE = 0.2  # below this share it is said what would show more
MOST_BALLS = 60  # to each of which another is added
WORTH = 1.5  # times what is shown, at least


@dataclass(frozen=True)
class Offer:
    """Something else that could be built, and the share of what its balls hide that it would show."""

    what: str
    share: float

    @property
    def sentence(self) -> str:
        """Advice and its effect."""
        return f"{self.what}: {percent(self.share)}"


@dataclass(frozen=True)
class Arranged:
    """A lab, and the share of what its balls hide that it shows."""

    lab: Lab
    share: float


def best_gap(lab: Lab, lens: bool) -> Arranged | None:
    """The lab with its balls as far off the plane as shows most.

    Parameters
    ----------
    lab : Lab
        Its gap is left open.
    lens : bool
        Whether its lens is left open too: the longest that sees all balls.

    Returns
    -------
    Arranged or None
        None if the balls have no place before this camera.
    """

    def at(part: float) -> Arranged | None:
        moved = replace(lab, gap_mm=round(part * lab.ball_mm, 1))
        return evaluate_lab(moved.with_usual_lens() if lens else moved)

    return _nearest(filter(None, map(at, PARTS)), lambda found: found.share)


@cache  # `init` asks for the same labs to place the balls and to say what else would show more
def evaluate_lab(lab: Lab) -> Arranged | None:
    """The lab with the share that it shows; None if it cannot be."""
    from rtpiv.templates.room import room_of  # of a bench: who has a scene does not wait

    try:
        room_of(lab)
        return Arranged(lab, coarse_share(scene_of(lab)))
    except (RunUsageError, SceneError):
        return None


def others(lab: Lab, lens: bool) -> list[Arranged]:
    """The same balls in every other arrangement and number, what shows most first.

    Parameters
    ----------
    lab : Lab
        Camera, light, size and glass of the balls.
    lens : bool
        Whether the lens is left open.
    """
    found = []
    for shape in ARRANGEMENTS:
        for count in list(most_balls(shape))[: 1 if shape in BEDS else 4]:
            if (shape, count) == (lab.arrangement, lab.balls) or (shape == "beside" and count == 1):
                continue
            if (best := best_gap(lab.with_equal_balls(arrangement=shape, balls=count), lens)) is not None:
                found.append(best)
    return sorted(found, key=lambda one: one.share, reverse=True)


def offers(scene: Scene) -> list[Offer]:
    """Return changes that show more of a scene: glass elsewhere, a second ball before each, a ball less."""
    if not scene.spheres:
        return []
    standing, found = _raise_glass(scene), list[Offer]()
    now, nearest = dict(standing)[0.0], max(scene.spheres, key=lambda ball: ball.centre_mm[2])
    for what, tried in (
        ("", standing),
        ("a second such ball before each", _raise_glass(_add_second_balls(scene))),
        (f"without {nearest.name}", _raise_glass(_without(scene, nearest))),
    ):
        best = _nearest(tried, lambda one: one[1])
        if best is not None and best[1] > max(
            WORTH * now, NEARLY + max((one.share for one in found), default=0.0)
        ):
            moved = f"the glass {abs(best[0]):g} mm {'farther from' if best[0] > 0.0 else 'nearer to'} the plane"
            found.append(Offer(" and ".join(filter(None, (what, moved if best[0] else ""))), best[1]))
    return found


def little(scene: Scene, shown: ThroughGlass | Gaps) -> str:
    """A sentence on what to change, where little of what balls hide is shown; empty if enough is, and in beds."""
    if isinstance(shown, Gaps) or shown.share >= LITTLE:
        return ""
    said = "; ".join(offer.sentence for offer in offers(scene))
    more = f" What would show more: {said}." if said else ""
    return f"Little of what the glass hides is seen in this plane.{more}"


def _raise_glass(scene: Scene | None) -> list[tuple[float, float]]:
    """Millimetres by which what goes with the glass is moved off the plane, and the share that is shown then."""
    if scene is None:
        return []
    diameter = 2.0 * max(ball.radius_mm for ball in scene.spheres)
    gap = min(ball.lowest_mm for ball in scene.spheres)
    found = []
    for by_mm in sorted({0.0, *(round(part * diameter - gap, 1) for part in (0.0, *PARTS))}):
        try:
            moved = scene.with_bodies([_move_with_glass(body, by_mm) for body in scene.bodies])
            found.append((by_mm, coarse_share(moved)))
        except SceneError:  # into the plane, the camera or another body
            continue
    return found


def _move_with_glass(body: Body, by_mm: float) -> Body:
    return body.moved(lambda at: (at[0], at[1], at[2] + by_mm)) if body.carried == "glass" else body


def _without(scene: Scene, ball: Sphere) -> Scene | None:
    """The scene without one of its balls; None of one ball."""
    rest = [body for body in scene.bodies if body is not ball]
    return scene.with_bodies(rest) if len(scene.spheres) > 1 else None


def _add_second_balls(scene: Scene) -> Scene | None:
    """The scene with another ball in contact before each, on the camera's side; None if there is no room."""
    if len(scene.spheres) > MOST_BALLS:
        return None
    more = [
        replace(
            ball,
            name=f"{ball.name} second",
            centre_mm=(*ball.centre_mm[:2], ball.centre_mm[2] + 2.0 * ball.radius_mm + AIR_MM),
        )
        for ball in scene.spheres
    ]
    try:
        return scene.with_bodies([*scene.bodies, *more])
    except SceneError:
        return None


def _nearest(tried: Iterable[Found], share: Callable[[Found], float]) -> Found | None:
    """The first of those that show nearly as much as the best."""
    found: Sequence[Found] = list(tried)
    best = max(map(share, found), default=0.0)
    return next((one for one in found if share(one) >= best - NEARLY), None)
