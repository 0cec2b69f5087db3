"""Share of the gaps of a bed that is seen: of the gas between the balls that the plane cuts.

The gaps are what is no glass within the hull of the discs that the plane cuts out of the balls, as far as the
corrected image reaches: gas around the bed does not count.  Where the file gives the light's sources, the first
figure is the share that is lit and seen, and a table says so of the gas around each ball.
"""

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from correction.maps.correction_map import CorrectionMap, nodes_in_glass
from correction.maps.lit import PlaneLight, light_of
from correction.masked import points_in
from rtpiv.analysis.through_glass import SAID_PX, ThroughGlass, coarse_map, coarsen_scene, percent, through_scene
from tracer.errors import TracerError
from tracer.scene.scene import Scene

RING = 0.25  # of the radius of a disc: the gas that counts as being around its ball
Vector2 = tuple[float, float]
CORNERS = 64  # of a disc's outline: they lie inside it by 0.1 % of its radius


@dataclass(frozen=True)
class BallSide:
    """Gas around one ball, within RING of its disc: the shares of it that are seen, lit and both, and its light.

    Parameters
    ----------
    name : str
        Of the ball.
    gas_mm2 : float
        Area of the gas.
    seen, lit, both : float
        Shares of it, 0 to 1.
    brightness, height_mm : float
        Median where it is lit; NaN where it is not.
    """

    name: str
    gas_mm2: float
    seen: float
    lit: float
    both: float
    brightness: float
    height_mm: float


@dataclass(frozen=True)
class LitGaps:
    """Light in the gaps: areas lit, and lit and seen; the gas around each ball; share of the light reflected."""

    lit_mm2: float
    both_mm2: float
    balls: tuple[BallSide, ...]
    reflected: float


@dataclass(frozen=True)
class Gaps:
    """Gaps between balls that the plane cuts.

    Parameters
    ----------
    gas_mm2 : float
        Their area within the corrected image.
    recovered_mm2 : float
        Part of it that is recovered.
    glass : float
        Share of the corrected image inside bodies.
    lit : LitGaps or None
        How they are lit, where the sources of the light are given.
    """

    gas_mm2: float
    recovered_mm2: float
    glass: float
    lit: LitGaps | None = None

    @property
    def share(self) -> float:
        """Recovered over whole area, 0 to 1."""
        return self.recovered_mm2 / self.gas_mm2

    @property
    def first(self) -> tuple[float, str]:
        """Share of the gaps that verbs and pages begin with, 0 to 1, and its name."""
        if self.lit is None:
            return self.share, "of the gaps is seen"
        return self.lit.both_mm2 / self.gas_mm2, "of the gaps is lit and seen"

    @property
    def sentence(self) -> str:
        """The figure that `trace` begins with inside a bed."""
        share, name = self.first
        begin = f"inside a bed: {percent(share)} {name}"
        areas = f"{share * self.gas_mm2:.4g} of {self.gas_mm2:.4g} mm\u00b2"
        if self.lit is None:
            return f"{begin} ({areas}); {percent(self.glass)} is glass"
        return (
            f"{begin} ({areas}): {percent(self.lit.lit_mm2 / self.gas_mm2)} is lit, {percent(self.share)} is seen;"
            f" {percent(self.glass)} is glass"
        )


def share_of_scene(scene: Scene) -> Gaps | ThroughGlass | None:
    """Measure what verbs begin with: the gaps in the sheet of a bed, else what is seen through glass.

    None if nothing is hidden, or the view has no map.
    """
    try:
        found = gaps_of_scene(scene.in_light_sheet())
    except TracerError:  # `correct` reports it: the glass may stand elsewhere while the sheet is on
        found = None
    return found or through_scene(scene)


def gaps_of_scene(scene: Scene) -> Gaps | None:
    """Measure the gaps of a scene in its sheet by a map of few pixels; None if it is no bed, or has no map."""
    try:
        if len(scene.spheres_in_plane) < 2:
            return None
        small = coarsen_scene(scene, SAID_PX)
        found = coarse_map(small, SAID_PX)
        return gap_share(small, found, light_of(small, found.grid))
    except TracerError:
        return None


def gap_share(scene: Scene, found: CorrectionMap, light: PlaneLight | None = None) -> Gaps | None:
    """Measure how much of the gaps a map recovers, and how much is lit; None where the plane cuts no two balls.

    Parameters
    ----------
    scene : Scene
        The scene.
    found : CorrectionMap
        Of it, whatever the light.
    light : PlaneLight, optional
        `light_of` the scene on its grid.
    """
    inside = nodes_in_glass(scene, found.grid)
    discs = [
        (ball.name, ball.centre_mm[:2], float(np.sqrt(max(ball.radius_mm**2 - ball.centre_mm[2] ** 2, 0.0))))
        for ball in scene.spheres_in_plane
    ]
    if inside is None or len(discs) < 2:
        return None
    angle = np.linspace(0.0, 2.0 * np.pi, CORNERS, endpoint=False)
    circle = np.stack((np.cos(angle), np.sin(angle)), axis=-1)
    points = np.concatenate([np.array(centre) + radius * circle for _, centre, radius in discs])
    gas = points_in(points[scipy.spatial.ConvexHull(points).vertices], found.grid.nodes_mm()) & ~inside
    if not gas.any():
        return None
    node_mm2, lit = found.grid.pitch_mm**2, None
    if light is not None:
        is_lit = light.on(~(light.too_dark() | light.too_bright()), found.grid.shape)
        sides = [_ball_side(disc, found, ~inside, is_lit, light) for disc in discs]
        lit_mm2, both_mm2 = (node_mm2 * int((gas & one).sum()) for one in (is_lit, is_lit & found.recovered))
        lit = LitGaps(
            lit_mm2, both_mm2, tuple(side for side in sides if side is not None), light.light.share_reflected
        )
    seen_mm2 = node_mm2 * int((gas & found.recovered).sum())
    return Gaps(node_mm2 * int(gas.sum()), seen_mm2, float(inside.mean()), lit)


def _ball_side(
    disc: tuple[str, Vector2, float],
    found: CorrectionMap,
    gas: NDArray[np.bool_],
    is_lit: NDArray[np.bool_],
    light: PlaneLight,
) -> BallSide | None:
    """Light in the gas (h, w) around a disc; None where the corrected image does not show any."""
    name, centre, radius = disc
    grid, reach = found.grid, (1.0 + RING) * radius
    (left, top), (right, bottom) = grid.to_px(np.array(centre) + np.array([[-reach, reach], [reach, -reach]]))
    rows, columns = (
        slice(max(0, int(low)), max(0, int(high) + 1)) for low, high in ((top, bottom), (left, right))
    )
    part = rows, columns
    away = np.linalg.norm(grid.nodes_mm()[part] - np.array(centre), axis=-1)
    around = gas[part] & (away < reach)
    if not around.any():
        return None
    seen, lit = found.recovered[part][around], is_lit[part][around]
    brightness, height = (
        light.on(field, grid.shape)[part][around][lit] for field in (light.light.brightness, light.light.height_mm)
    )
    figures = (float(np.median(field)) if lit.any() else float("nan") for field in (brightness, height))
    shares = (float(which.mean()) for which in (seen, lit, seen & lit))
    return BallSide(name, grid.pitch_mm**2 * int(around.sum()), *shares, *figures)
