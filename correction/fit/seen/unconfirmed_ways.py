"""Ways through the glass on which too few corners of the target are where the scene shows them.

One ball that is seen badly, or stands elsewhere, is no reason to refuse all others.  A way on which less than
BRANCH_LIMIT of its corners are found is masked, and so is everything around a ball of which no way is confirmed:
its outline in the frame, made wider by what is not known of its place.

Few corners do not determine a position: a ball has three coordinates and each corner gives two equations, so that
a wrong position may fit them.  A ball of which few are seen must therefore also stand where its own rim hides the
lattice (`silhouettes`); if it does not, what is masked is around both places.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from correction.fit.seen.rims_seen import RimSeen
from correction.masked import hull_px
from tracer.bodies import Sphere
from tracer.camera import Camera, Vector3
from tracer.masked import UNCONFIRMED, MaskedPart
from tracer.scene.scene import Scene
from tracer.strategies.branches import branch_of

BRANCH_LIMIT = 0.5  # share of the corners of a branch, if the scene shows at least so many on it
BRANCH_CORNERS = 5
TRUSTED_CORNERS = 12  # corners that are where a ball shows them, from which no rim is asked
MASK_SIGMAS = 3.0  # standard deviations of a ball's place sideways


@dataclass(frozen=True)
class Unconfirmed:
    """A way through the glass, or a ball, that corners do not confirm.

    Parameters
    ----------
    name : str
        Spheres crossed, joined by " > "; or one ball, of which no way is confirmed.
    paired, expected : int
        Corners that are where the scene shows them, and all that it shows.
    is_ball : bool
        Whether no way through the ball is confirmed.
    masked : tuple of MaskedPart
        What no map is to use.
    rim_is_elsewhere : bool
        Whether it does not stand where its rim is seen.
    likely_identity : str
        What it seems to be, in a sentence (`seen_through`), if that is known.
    """

    name: str
    paired: int
    expected: int
    is_ball: bool
    masked: tuple[MaskedPart, ...]
    rim_is_elsewhere: bool = False
    likely_identity: str = ""

    @property
    def share(self) -> float:
        """Share of its corners that are where the scene shows them."""
        return self.paired / max(self.expected, 1)

    def __str__(self) -> str:
        """Return one sentence."""
        found = (
            f"{self.paired} of {self.expected} corners seen through `{self.name}` are where the scene shows them"
        )
        if self.likely_identity:
            return f"{self.likely_identity}; the ball is masked in every map"
        if self.rim_is_elsewhere:
            return (
                f"`{self.name}` does not stand where its rim is seen, and no more than {self.paired} corners are"
                " seen through it: the ball is not confirmed, and is masked in every map; give its place to a"
                " millimetre, or print smaller squares"
            )
        if self.is_ball:
            cure = (
                "look for dirt on it, check its place, radius and glass, and whether it is hollow, or print"
                " smaller squares"
            )
            return f"only {found}: the ball is not confirmed, and is masked in every map; {cure}"
        return f"only {found}: this way through the glass is masked in every map"


@dataclass(frozen=True)
class Misfit:
    """A way through the glass that a frame shows bent otherwise than the scene bends it.

    Parameters
    ----------
    way : str
        Spheres crossed, joined by " > ".
    share : float
        Of its pixels that show another square.
    ball : str
        The ball on the way that is most likely not as the scene says.
    frame : str
        Where it is seen.
    """

    way: str
    share: float
    ball: str
    frame: str

    @property
    def masked(self) -> MaskedPart:
        """The part that no map is to use."""
        return MaskedPart(UNCONFIRMED, through=branch_of(self.way))

    def __str__(self) -> str:
        """Return one sentence."""
        return (
            f"{self.frame}: {100.0 * self.share:.0f} % of what is seen through `{self.way}` are other squares than"
            f" the scene shows: radius, glass or place of `{self.ball}` are not as the scene says, it is hollow,"
            " or a ball that the scene does not list stands there; this way is masked in every map; measure the"
            " ball, or list what stands there"
        )


def mask_around(rim: RimSeen, scene: Scene) -> tuple[MaskedPart, ...]:
    """Parts that no map is to use around a ball whose rim is not where the scene shows it."""
    ball = next(ball for ball in scene.spheres if ball.name == rim.ball)
    return (_around(ball, scene.camera, rim.off_px * rim.pixel_mm),)


def find_unconfirmed(
    scene: Scene,
    expected: Mapping[str, int],
    paired: Mapping[str, int],
    place_mm: Mapping[str, float],
    rim_mm: Mapping[str, Vector3] | None = None,
    rather: Mapping[str, str] | None = None,
) -> tuple[Unconfirmed, ...]:
    """Ways and balls that corners do not confirm, balls first.

    Parameters
    ----------
    scene : Scene
        As fitted.
    expected, paired : mapping
        Way through the glass -> corners that the scene shows on it, and those that are there.
    place_mm : mapping
        Ball that may have moved -> standard deviation of its place sideways, once all corners are seen.
    rim_mm : mapping, optional
        Ball that does not stand where its own rim is seen -> its centre there.
    rather : mapping, optional
        Ball through which other squares are seen -> what it seems to be.
    """
    rim_mm, rather = rim_mm or {}, rather or {}
    failed = {
        way
        for way, count in expected.items()
        if count >= BRANCH_CORNERS and paired.get(way, 0) < BRANCH_LIMIT * count
    }
    balls = []
    for sphere in scene.spheres:
        ways = [way for way in expected if sphere.is_on(branch_of(way))]
        count = sum(expected[way] for way in ways)
        there = sum(paired.get(way, 0) for way in ways if way not in failed)
        elsewhere = sphere.name in rim_mm and 0 < there < TRUSTED_CORNERS
        is_lost = sphere.name in place_mm and count and (elsewhere or not there)
        if is_lost or sphere.name in rather:
            parts = tuple(MaskedPart(UNCONFIRMED, through=branch_of(way)) for way in ways)
            at = [sphere, *([replace(sphere, centre_mm=rim_mm[sphere.name])] if elsewhere else [])]
            wider_mm = MASK_SIGMAS * place_mm.get(sphere.name, 0.0)
            outlines = [_around(one, scene.camera, wider_mm) for one in at]
            total = sum(paired.get(way, 0) for way in ways)
            seems = rather.get(sphere.name, "")
            balls.append(Unconfirmed(sphere.name, total, count, True, (*outlines, *parts), elsewhere, seems))
            failed -= set(ways)
    ways_alone = [
        Unconfirmed(
            way, paired.get(way, 0), expected[way], False, (MaskedPart(UNCONFIRMED, through=branch_of(way)),)
        )
        for way in sorted(failed)
    ]
    return (*balls, *ways_alone)


def _around(sphere: Sphere, camera: Camera, wider_mm: float) -> MaskedPart:
    """Outline of a ball in the raw frame, of a radius larger by so much."""
    eye, centre = np.array(camera.position_mm), np.array(sphere.centre_mm)
    away = centre - eye
    distance = float(np.linalg.norm(away))
    towards = away / distance
    half = np.arcsin(min((sphere.radius_mm + wider_mm) / distance, 0.99))
    aside = np.linalg.svd(towards[None, :])[2][1:]
    angle = np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False)
    ring = np.cos(angle)[:, None] * aside[0] + np.sin(angle)[:, None] * aside[1]
    points = eye + distance * (np.cos(half) * towards + np.sin(half) * ring)
    return MaskedPart(UNCONFIRMED, hull_px(camera.project(points)))
