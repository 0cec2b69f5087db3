"""Find the light sheet in the frames of a flow: what is seen twice has to be at one place.

Each round makes the map for the sheet as known so far, looks for places seen twice, measures their disparities and
corrects the plane, until it moves by less than two sigmas (places are drawn anew).  Stereo PIV finds its sheet
in the same way with two cameras (Wieneke, Exp. Fluids 39, 267 (2005)); here the second camera is the glass.

Thickness: particles lie at heights with the spread s of the sheet's light squared, and D s widens the peaks along
D.  For light that is Gaussian across, with full width w at e^-2, s = w / sqrt(32).

**An unsure scene.**  If the scene is off by dx, the pixel that shows X in view a seems to show X + G_a dx
(`SceneSigma.spread`), and that of view b X + G_b dx.  The views then lie apart by (G_b - G_a) dx, which looks like
the height

    (G_b - G_a) dx . D / |D|^2.

Behind two balls 10 um of a ball along the view are 0.17 mm of height; they are the same in all frames and nearly
so in all cells.

**The plane** comes from heights of cells by weighted least squares with what was known before.  Unknown are
corrections of z and of the two slopes; each cell says  dz + x da + y db = height +- sigma.  Cells that lie off by
more than they may are given less weight (Huber).  If the rest scatters more than its sigmas say, all of these are
enlarged.  Errors that cells share (`Disparities.common_mm`) are unknowns beside the plane, each 0 +- 1: so what
they make of the plane stays in its covariance however many cells there are.  If kinds of views disagree, or
something moved across D, the sheet alone is not what is off.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from correction.fitted.scene_sigma import SceneSigma
from correction.light_sheet.disparities import BLOCKS, Disparities, Light, Pairs, disparities
from correction.light_sheet.double_views import AROUND, DoubleViews, double_views, some_of_each
from tracer.light_sheet import LightSheet
from tracer.scene.scene import Scene

TUNING, FARTHEST = 1.5, 5.0  # usual deviations from which on a cell counts less, and not at all
SHEET_FALSE_ALARMS = 0.001
PLANE_ROUNDS = 20
LEAST_ACROSS_PX, LEAST_APART_MM = 0.08, 0.03  # what corner and particle models leave; less is no finding
MIN_PEAK_SHARE = 0.05  # the same, of the width of the peaks
PLACES = 12  # of a cell
MOST_PLACES = 30_000
CELLS_ACROSS = 8  # of the view
LEAST_PLACES = 12  # of a cell
VIEW_MARGIN_PX = 3.0
LEAST_ROUNDS, ROUNDS = 2, 5  # the first one looks at heights that are far apart
SETTLED, AT_REST = 2.0, np.array([2e-3, 5e-5, 5e-5])  # of sigma; mm and slopes below any measurement
TELLS = 0.7  # of the sigma known before, below which the frames have added something
SIGMAS, DEPTH_MM = 3.0, 0.7  # heights looked at: of what is unsure, and of the sheet itself
MOST_REACH = 20  # lags to either side along D


@dataclass(frozen=True)
class PlaneFit:
    """Correction of the sheet's plane.

    Parameters
    ----------
    step : (3,) float64
        dz [mm], da, db.
    covariance : (3, 3) float64
        With what was known before.
    scatter : float
        Root of chi^2 a degree of freedom of the cells' heights; sigmas are enlarged by it if it is above 1.
    residual_mm : (C,) float64
        Heights of cells minus the plane, and minus what is common to them.
    weight : (C,) float64
        1, or less for cells that lie off.
    across_px : float
        Weighted rms of the disparities across D beyond their sigmas; 0 if chance makes as much.
    kinds_mm : dict
        Kind -> mean height of its cells over the plane found, and sigma.
    """

    step: NDArray[np.float64]
    covariance: NDArray[np.float64]
    scatter: float
    residual_mm: NDArray[np.float64]
    weight: NDArray[np.float64]
    across_px: float
    kinds_mm: dict[int, tuple[float, float]]

    @property
    def kinds_disagree(self) -> bool:
        """True if some kind of views disagrees with the plane of all on the height."""
        limit = float(np.sqrt(scipy.special.chdtri(1, SHEET_FALSE_ALARMS / max(len(self.kinds_mm), 1))))
        return len(self.kinds_mm) > 1 and any(
            abs(off) > max(limit * sigma, LEAST_APART_MM) for off, sigma in self.kinds_mm.values()
        )


def fit_plane(found: Disparities, known: NDArray[np.float64], covariance: NDArray[np.float64]) -> PlaneFit:
    """Fit the plane.

    Parameters
    ----------
    found : Disparities
        Of at least one cell.
    known : (3,) float64
        What was known before of (dz, da, db), relative to the plane of the map.
    covariance : (3, 3) float64
        Of what was known.
    """
    design = np.column_stack((np.ones(len(found.kind)), found.place_mm, found.common_mm))
    height, sigma = found.height_mm, found.height_sigma_mm
    before = np.eye(design.shape[1])
    before[:3, :3] = np.linalg.inv(covariance)
    expected = np.concatenate((known, np.zeros(len(before) - 3)))
    share, scatter, answer = np.ones(len(height)), 1.0, expected
    for _ in range(PLANE_ROUNDS):
        weight = share / (sigma * scatter) ** 2
        normal = design.T @ (weight[:, None] * design) + before
        answer = np.asarray(np.linalg.solve(normal, design.T @ (weight * height) + before @ expected), np.float64)
        off = np.abs(height - design @ answer) / sigma
        usual = max(1.0, 1.4826 * float(np.median(off)))
        share = np.where(off < FARTHEST * usual, np.minimum(1.0, TUNING * usual / np.maximum(off, 1e-9)), 0.0)
        freedom = max(1.0, float(share.sum()) - 3.0)
        scatter = max(1.0, float(np.sqrt(np.sum(share * off**2) / freedom)))
    residual = height - design @ answer
    kinds = {}
    for kind in np.unique(found.kind):
        here = found.kind == kind
        trust = share[here] / (sigma[here] * scatter) ** 2
        if trust.sum() > 0.0:
            kinds[int(kind)] = (float(trust @ residual[here] / trust.sum()), float(1.0 / np.sqrt(trust.sum())))
    covered = np.asarray(np.linalg.inv(normal)[:3, :3], np.float64)
    return PlaneFit(answer[:3], covered, scatter, residual, share, _across(found, share), kinds)


def _across(found: Disparities, share: NDArray[np.float64]) -> float:
    """Disparity across D beyond what chance makes [px], of cells that count."""
    off, sigma = found.across_px[share > 0.0], found.across_sigma_px[share > 0.0]
    unsure = (BLOCKS - 1.0) / (BLOCKS - 3.0)  # of sigmas that ten parts of the frames give
    if np.sum((off / sigma) ** 2) < unsure * scipy.special.chdtri(len(off), SHEET_FALSE_ALARMS):
        return 0.0
    weight = sigma**-2.0
    excess = float(np.sum(weight * (off**2 - sigma**2)) / weight.sum())
    size = float(np.sqrt(max(excess, 0.0)))
    widest_px = float(found.width_px[share > 0.0].max())
    return size if size > max(LEAST_ACROSS_PX, MIN_PEAK_SHARE * widest_px) else 0.0


def scene_doubt(
    scene: Scene, views: DoubleViews, cell: NDArray[np.int64], sigma: SceneSigma
) -> NDArray[np.float64]:
    """Spread (C, P) [mm] of the heights of cells; cells of one column belong to the same draw.

    Parameters
    ----------
    scene : Scene
        That of the views, in the plane of the map.
    views : DoubleViews
        N places seen twice.
    cell : (N,) int64
        Cell of each place, 0 ...
    sigma : SceneSigma
        Of the scene, as seen in this plane (`SceneSigma.in_light_sheet`); the plane's own is left out.
    """
    some = some_of_each(cell, PLACES)
    seen, cells = views.at(some), cell[some]
    glass = sigma.of_glass()
    first, second = (glass.spread(scene, np.ascontiguousarray(seen.chief_px[:, view])) for view in (0, 1))
    off = np.einsum("nip,ni->np", second - first, seen.towards / seen.parallax[:, None])
    good = np.isfinite(off).all(axis=1)
    total = np.zeros((int(cell.max()) + 1, off.shape[1]))
    np.add.at(total, cells[good], off[good])
    return np.asarray(total / np.maximum(np.bincount(cells[good], minlength=len(total)), 1)[:, None])


@dataclass(frozen=True)
class SheetFound:
    """The light sheet as particles show it.

    Parameters
    ----------
    sheet : LightSheet
        With sigmas; those known before where the frames tell nothing.
    known : LightSheet
        What was known before.
    views : DoubleViews
        Places seen twice, in the sheet found.
    cells : Disparities or None
        Of the last round; None if no cell had a clear peak.
    fit : PlaneFit or None
        Of the last round.
    pairs : int
        Pairs of frames.
    rounds : int
        Maps made.
    verdicts : tuple of str
        What a reader must know, in words.
    """

    sheet: LightSheet
    known: LightSheet
    views: DoubleViews
    cells: Disparities | None
    fit: PlaneFit | None
    pairs: int
    rounds: int
    verdicts: tuple[str, ...]


def find_sheet(scene: Scene, pairs: Pairs, sigma: SceneSigma | None = None) -> SheetFound:
    """Find the light sheet of a scene.

    Parameters
    ----------
    scene : Scene
        As the camera saw it, fitted; its `sheet` says what is known, nothing: z = 0 within half a millimetre.
    pairs : callable
        Gives the raw pairs of frames of a flow, the same ones at each call.
    sigma : SceneSigma, optional
        What the scene's fit is unsure of; without it the scene is taken to be exact.

    Raises
    ------
    SheetError
        There are too few pairs.
    SceneError
        The sheet runs through a body.
    """
    known = scene.lit
    light, count = Light.of(pairs, BLOCKS, "where the sheet is")
    now, cells, fit, rounds = known, None, None, 0
    for rounds in range(1, ROUNDS + 1):
        # Views are traced anew for the sheet as it is known by now.
        seen = replace(scene, sheet=now).in_light_sheet()
        views = double_views(seen, most=MOST_PLACES)
        sigma_mm = known.sigma_mm if rounds == 1 else now.sigma_mm
        reach = _reach(views, sigma_mm)
        views = _inside(views, scene.camera.shape, reach)
        views, cell = _cells(views, scene)
        reach_mm = SIGMAS * sigma_mm + DEPTH_MM
        cells = disparities(seen, views, cell, pairs, light, count, reach, reach_mm) if len(cell) else None
        if cells is None or not len(cells.kind):
            return _nothing(known, views, count, rounds)
        # What the fit is unsure of moves all views of a kind together: an unknown that their cells share.
        if sigma is not None:
            common = scene_doubt(seen, views, cell, sigma.in_light_sheet(replace(scene, sheet=now)))
            cells = replace(cells, common_mm=np.column_stack((cells.common_mm, common[cells.number])))
        # What was known before counts as a measurement, wherever the rounds have come to.
        fit = fit_plane(cells, plane_of(known) - plane_of(now), _covariance(known))
        before, now = now, _correct_sheet(now, fit, known)
        step = np.abs(plane_of(now) - plane_of(before))
        # Settled: no number moves by more than a part of its own sigma.
        near = step < np.maximum(SETTLED * np.sqrt(np.diag(fit.covariance)), AT_REST)
        if near.all() and rounds >= LEAST_ROUNDS:
            break
    assert fit is not None
    assert cells is not None
    wrong = [*_describe_moved_glass(fit, views), *_far(now, known)]
    said = [*wrong, *_untold(now, known)]
    if wrong:
        now = known
    elif scene.sheet is None and now.sigma_mm <= TELLS * known.sigma_mm:
        now = _without_guess(now, known)
    now = replace(now, thickness_mm=thickness_mm(cells) or known.thickness_mm)
    return SheetFound(now, known, views, cells, fit, count, rounds, tuple(said))


def thickness_mm(cells: Disparities) -> float | None:
    """Full width of the sheet at e^-2 from the widths of the peaks; None where they do not tell."""
    mean, unsure = cells.spread2_mm2
    return float(np.sqrt(32.0 * mean)) if mean > 3.0 * unsure else None


def _nothing(known: LightSheet, views: DoubleViews, count: int, rounds: int) -> SheetFound:
    why = (
        "no particle of this view is seen twice"
        if not len(views.kind)
        else f"{views.area_mm2:.1f} mm2 are seen twice, but the two views of the particles do not agree anywhere"
    )
    said = f"the frames do not tell where the light sheet is: {why}; measure it, and say it in the scene file"
    return SheetFound(known, known, views, None, None, count, rounds, (said,))


def _untold(now: LightSheet, known: LightSheet) -> list[str]:
    """List in words what the frames do not determine."""
    parts = (
        ("height", now.sigma_mm > TELLS * known.sigma_mm),
        ("tilt", now.tilt_sigma_deg > TELLS * known.tilt_sigma_deg),
    )
    return [
        f"the frames tell little of the {part} of the light sheet: its sigma is what was known before"
        for part, little in parts
        if little
    ]


def _describe_moved_glass(fit: PlaneFit, views: DoubleViews) -> list[str]:
    """Describe the evidence for a body that is not in its place."""
    said = []
    if fit.across_px:
        said.append(
            f"views of one particle lie {fit.across_px:.2f} px apart across the way that any height of the sheet"
            " moves them"
        )
    if fit.kinds_disagree:
        named = "; ".join(
            f"{' and '.join(map(_name_view, views.kinds[kind]))}: {1e3 * off:+.0f} +- {1e3 * sigma:.0f} um"
            for kind, (off, sigma) in fit.kinds_mm.items()
        )
        said.append(f"views through different bodies see different heights ({named})")
    cure = (
        ": a body is not where the scene has it; the sheet is left as it was known, so calibrate the glass again"
    )
    return [sentence + cure for sentence in said]


def _far(now: LightSheet, known: LightSheet) -> list[str]:
    """Describe the evidence against an unexpected plane: along the view a moved body looks like another height."""
    off = (plane_of(now) - plane_of(known)) / np.sqrt(np.diag(_covariance(known)))
    parts = (
        f"{now.z_mm:+.2f} mm high",
        f"tilted by {now.tilt_x_deg:+.2f} deg along x",
        f"tilted by {now.tilt_y_deg:+.2f} deg along y",
    )
    return [
        f"the sheet would be {what}, {abs(sigmas):.1f} sigmas from what was known: either that is wrong, or "
        "a body is not where the scene has it; the sheet is left as it was known, so measure it, say it in the "
        "scene file with its sigma, or calibrate the glass again"
        for what, sigmas in zip(parts, off, strict=True)
        if abs(sigmas) > SIGMAS
    ]


def _name_view(branch: tuple[str, ...]) -> str:
    return "through " + ", ".join(branch) if branch else "direct"


def plane_of(sheet: LightSheet) -> NDArray[np.float64]:
    """Height [mm] and slopes (3,) of a sheet."""
    return np.array([sheet.z_mm, *sheet.slopes])


def _covariance(sheet: LightSheet) -> NDArray[np.float64]:
    """Of height and slopes; never singular."""
    root = sheet.root()
    return np.asarray(root @ root.T + np.diag([1e-6**2, 1e-8**2, 1e-8**2]))


def _correct_sheet(now: LightSheet, fit: PlaneFit, known: LightSheet) -> LightSheet:
    """The sheet with a correction of its plane, and its sigma."""
    return sheet_with_plane(plane_of(now) + fit.step, fit.covariance, known)


def sheet_with_plane(plane: NDArray[np.float64], covariance: NDArray[np.float64], like: LightSheet) -> LightSheet:
    """The sheet of height and slopes (3,) and their covariance, with the light of another one."""
    z, a, b = plane
    sigma = np.sqrt(np.diag(covariance))
    shares = covariance / np.outer(sigma, sigma)
    tilt = float(np.rad2deg(np.sqrt(np.mean([(sigma[1] / (1 + a * a)) ** 2, (sigma[2] / (1 + b * b)) ** 2]))))
    return LightSheet(
        float(z), float(np.rad2deg(np.arctan(a))), float(np.rad2deg(np.arctan(b))), float(sigma[0]), tilt,
        (float(shares[0, 1]), float(shares[0, 2]), float(shares[1, 2])), like.thickness_mm, like.sources,
    )  # fmt: skip


def _without_guess(now: LightSheet, known: LightSheet) -> LightSheet:
    """The sheet by the frames and the guessed tilt alone: a guess of the height draws all heights towards it."""
    guess = np.diag([known.sigma_mm**-2.0, 0.0, 0.0])
    information = np.linalg.inv(_covariance(now))
    covariance = np.asarray(np.linalg.inv(information - guess))
    answer = covariance @ (information @ plane_of(now) - guess @ plane_of(known))
    return sheet_with_plane(answer, covariance, now)


def _reach(views: DoubleViews, sigma_mm: float) -> int:
    """Lags along D that hold three sigmas of the height, and the peak around them."""
    if not len(views.kind):
        return 0
    lag_mm = views.units()[:, 0] * views.pitch_mm / views.parallax  # height for a lag of one
    needed = SIGMAS * sigma_mm / float(np.quantile(lag_mm, 0.1)) + AROUND
    return int(np.clip(np.ceil(needed), AROUND, MOST_REACH))


def _inside(views: DoubleViews, shape: tuple[int, int], reach: int) -> DoubleViews:
    """Places whose two views, with all lags, lie inside the sensor and show one picture of a particle."""
    size = np.array(shape[::-1]) - 1.0
    good, room = views.free(reach), views.room_px(reach)
    for pixel, more in ((views.first_px, 0.0), (views.second_px, room)):
        good &= ((pixel - more >= VIEW_MARGIN_PX) & (pixel + more <= size - VIEW_MARGIN_PX)).all(axis=1)
    return views.at(good)


def _cells(views: DoubleViews, scene: Scene) -> tuple[DoubleViews, NDArray[np.int64]]:
    """Some of the places, and the cell of each: a square of the plane, and one kind of views."""
    if not len(views.kind):
        return views, np.empty(0, np.int64)
    side_mm = max(scene.camera.shape) * views.pitch_mm / CELLS_ACROSS
    square = np.floor(views.place_mm / side_mm).astype(np.int64) + 1000
    number = (views.kind * 10000 + square[:, 0]) * 10000 + square[:, 1]
    _, cell, places = np.unique(number, return_inverse=True, return_counts=True)
    keep = places[cell] >= LEAST_PLACES
    views = views.at(keep)
    return views, np.unique(cell[keep], return_inverse=True)[1].astype(np.int64)
