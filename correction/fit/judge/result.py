"""Result of a scene fit, and the gates that it must pass."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from correction.errors import FitFailed
from correction.fit.judge.verdict import PRIOR_LIMIT, Verdict
from correction.fit.seen.unconfirmed_ways import BRANCH_LIMIT
from correction.fit.solve.considered import ShapeRoot
from correction.fit.solve.light import LightUncertainty
from correction.fit.solve.solver import packing_residuals
from correction.fit.solve.unknowns import Unknowns
from correction.target import Chessboard
from ground.short_repr import short_repr
from tracer.scene.scene import Scene
from tracer.strategies.branches import text_of
from tracer.strategies.sensitivity import SPHERE

RMS_TIMES = 20.0  # residuals behind glass over those beside it: right fits 1-5, an ellipsoid of 50 um 5-10
RMS_BOUNDS_PX = (0.15, 0.5)  # of the limit that follows: a wrong pairing leaves more than either
# Of the corners behind glass; right fits pair 0.85-1, supports that no scene names cost some
SHARE_LIMIT = 0.75
FEW_CORNERS = 20  # behind glass, from which a share of them says little
OVERLAP_LIMIT_MM = 0.02
CONTACT_LIMIT = 4.0  # sigmas that balls may be apart which are said to touch


@dataclass(frozen=True)
class FitStep:
    """One line of a fit's history.

    Parameters
    ----------
    name : str
        What happened.
    corners : int
        Corners fitted, or saddles paired; 0 where nothing was fitted.
    rms_px : float
        Their rms residual per axis; NaN where nothing was fitted.
    remark : str
        What else is to be said.
    """

    name: str
    corners: int = 0
    rms_px: float = float("nan")
    remark: str = ""

    def __str__(self) -> str:
        """Return one line."""
        if not self.corners:
            return self.name
        said = f"{self.name}: {self.corners} corners, rms {self.rms_px:.3f} px"
        return f"{said}, {self.remark}" if self.remark else said


@dataclass(frozen=True)
class FittedCorners:
    """Corners of all frames with their residuals, N in total.

    Parameters
    ----------
    frame : (N,) int64
        Number of the frame in `SceneFit.frames`.
    index : (N, 2) int64
        Corner of the board.
    pixel, residual_px : (N, 2) float64
        Where it was measured, and measured minus fitted, in raw px.
    branch_name : (N,) str
        Spheres crossed, joined by " > "; empty for the direct view.
    inlier : (N,) bool
        Used by the fit.
    rim_px : (N,) float64
        Distance to the border of the branch.
    """

    frame: NDArray[np.int64]
    index: NDArray[np.int64]
    pixel: NDArray[np.float64]
    residual_px: NDArray[np.float64]
    branch_name: NDArray[np.str_]
    inlier: NDArray[np.bool_]
    rim_px: NDArray[np.float64]

    @property
    def behind(self) -> NDArray[np.bool_]:
        """Corners seen through glass (N,)."""
        return np.asarray(self.branch_name != "")

    def rms_px(self, behind: bool) -> NDArray[np.float64]:
        """Root mean square residual per axis (2,) of the inliers of a region."""
        chosen = self.inlier & (self.behind == behind)
        return np.asarray(np.sqrt((self.residual_px[chosen] ** 2).mean(axis=0)))


@short_repr
@dataclass(frozen=True)
class SceneFit:
    """A fitted scene and its uncertainty.

    Parameters
    ----------
    scene : Scene
        The fitted scene.
    unknowns : Unknowns
        What was free, around the nominal scene.
    x : (P,) float64
        The free vector in units of the prior's sigmas.
    covariance : (P, P) float64
        Of x.
    normal : (P, P) float64
        Normal matrix of the data alone.
    root : (F, R) float64
        root root^T is the covariance of the full vector: of what was free, and of what was held and may be wrong.
    frames : tuple of str
        Names of the frames.
    corners : FittedCorners
        Every corner.
    expected : dict
        Way through the glass -> corners that the fitted scene shows on it.
    refused : dict
        Reason -> corners that could not be measured.
    pushed_mm : float
        Overlap removed at the end.
    measured_scene : Scene
        The fitted scene in the light of the measurement; `scene` is in that of the target frames.
    verdict : Verdict
        Whether the model is right, and what is wrong with it where it is not.
    history : tuple of FitStep
        What happened.
    light : LightUncertainty
        What is not known of the light of the target frames.
    shapes : ShapeRoot
        What is not known of the shapes of balls taken for spheres, in the draws of `root`.
    board : Chessboard
        The target, as large as its print was found to be.
    joint : (str, int)
        Key of a joint fit of several cameras, and number of the first columns of `root` that are the same draws in
        all of them (`correction.fit.joint_cameras`).
    """

    scene: Scene
    unknowns: Unknowns
    x: NDArray[np.float64]
    covariance: NDArray[np.float64]
    normal: NDArray[np.float64]
    root: NDArray[np.float64]
    frames: tuple[str, ...]
    corners: FittedCorners
    expected: dict[str, int]
    refused: dict[str, int]
    pushed_mm: float
    measured_scene: Scene
    verdict: Verdict
    history: tuple[FitStep, ...] = field(default=())
    light: LightUncertainty = field(default_factory=LightUncertainty)
    shapes: ShapeRoot = field(default_factory=ShapeRoot)
    board: Chessboard = field(default_factory=Chessboard)
    joint: tuple[str, int] = ("", 0)

    @property
    def names(self) -> tuple[str, ...]:
        """Free numbers."""
        return self.unknowns.names

    @property
    def values(self) -> NDArray[np.float64]:
        """Fitted values (P,) in the units of their names: mm, rad, px."""
        full = self.unknowns.full(self.x)
        first = np.argmax(self.unknowns.columns != 0.0, axis=0)
        return np.asarray(full[first])

    @property
    def sigmas(self) -> NDArray[np.float64]:
        """Standard deviations (P,) of `values`."""
        return np.asarray(self.unknowns.sigma * np.sqrt(np.diag(self.covariance)))

    @property
    def corners_expected(self) -> int:
        """Corners behind glass that the fitted scene shows."""
        return sum(self.expected.values())

    @property
    def corners_paired(self) -> int:
        """Those measured and used."""
        return int(np.count_nonzero(self.corners.behind & self.corners.inlier))

    @property
    def ball_root(self) -> NDArray[np.float64]:
        """Rows (B, 4, P) of `root` that belong to x, y, z and radius of each ball [mm]."""
        return self.root[self.unknowns.glass].reshape(-1, len(SPHERE), self.root.shape[1])[:, :4]

    def count_paired(self, branch_name: str) -> int:
        """Corners measured and used that are seen through one branch."""
        return int(np.count_nonzero(self.corners.inlier & (self.corners.branch_name == branch_name)))

    @property
    def share(self) -> float:
        """Share of the visible corners behind glass that were measured and used, where the target confirms any."""
        lost = self.verdict.unconfirmed
        expected = self.corners_expected - sum(one.expected for one in lost)
        return (self.corners_paired - sum(one.paired for one in lost)) / max(expected, 1)

    @property
    def rms_confirmed_px(self) -> NDArray[np.float64]:
        """Root mean square residual per axis (2,) behind glass, of the ways that the target confirms."""
        lost = {text_of(part.through) for one in self.verdict.unconfirmed for part in one.masked if part.through}
        kept = self.corners.inlier & self.corners.behind & ~np.isin(self.corners.branch_name, list(lost))
        return np.asarray(np.sqrt((self.corners.residual_px[kept] ** 2).mean(axis=0)))


def rms_limit_px(corner_noise_px: float) -> float:
    """Largest residual that is still taken as a fit, by the corner noise of a right model."""
    return float(np.clip(RMS_TIMES * corner_noise_px, *RMS_BOUNDS_PX))


def check(fit: SceneFit) -> None:
    """Hold a fit against its gates.

    Raises
    ------
    FitFailed
        Naming gate, value and limit.
    """
    cure = (
        "check that the scene lists every sphere, its radius and glass, and the core of a hollow one, that the"
        " board fills the view behind the glass, and that nothing moved between frames"
    )
    if fit.verdict.alarms:
        cure = f"{fit.verdict.sentences[0]}; {cure}"
    if fit.corners.behind.any():
        lost = fit.verdict.unconfirmed
        if lost and sum(one.expected for one in lost) > (1.0 - SHARE_LIMIT) * fit.corners_expected:
            worst = min(lost, key=lambda one: (not one.is_ball, one.share))
            raise FitFailed(
                f"share of corners paired through {worst.name}",
                worst.share,
                BRANCH_LIMIT,
                f"corners through {worst.name} are not where it would show them; check its place, radius and"
                f" glass, or hold it fixed in the fit section, and {cure}",
            )
        rms = float(fit.rms_confirmed_px.max())
        limit = rms_limit_px(fit.verdict.corner_noise_px)
        if not rms <= limit:
            raise FitFailed("rms behind glass [px]", rms, limit, cure)
        if fit.share < SHARE_LIMIT:
            if fit.corners_expected < FEW_CORNERS:
                cure = (
                    f"the scene shows only {fit.corners_expected} corners behind glass, of which"
                    f" {fit.corners_paired} were found; squares of another size or a longer lens would show"
                    f" more, or {cure}"
                )
            raise FitFailed("share of visible corners paired", fit.share, SHARE_LIMIT, cure)
    if fit.pushed_mm > OVERLAP_LIMIT_MM:
        raise FitFailed("overlap of bodies [mm]", fit.pushed_mm, OVERLAP_LIMIT_MM, cure)
    _check_contacts(fit)
    pull = float(np.abs(fit.x).max(initial=0.0))
    if pull > PRIOR_LIMIT:
        name = fit.names[int(np.argmax(np.abs(fit.x)))]
        text = f"{name} had to move that many of its sigmas; check its value, or allow more in the fit section"
        if fit.verdict.cause is not None:
            text = f"{fit.verdict.cause.sentence}. With that held, {text}"
        else:  # one number may have been pulled by the error of another that is held tighter
            text = "; ".join([*map(str, fit.verdict.pulls), text])
        raise FitFailed("distance from the prior [sigma]", pull, PRIOR_LIMIT, text)
    if fit.verdict.pulls and (joint := fit.verdict.pulls[0]).sigmas > PRIOR_LIMIT:
        raise FitFailed("joint distance from the priors [sigma]", joint.sigmas, PRIOR_LIMIT, joint.reason)


def _check_contacts(fit: SceneFit) -> None:
    """Refuse a fit in which balls that are known to touch do not."""
    for part in packing_residuals(fit.unknowns, fit.x):
        apart, worst = np.abs(part.value[:, 0]), int(np.argmax(np.abs(part.value[:, 0])))
        if apart[worst] > CONTACT_LIMIT:
            one, other = list(fit.unknowns.packing.values())[worst]
            names = [fit.unknowns.scene.spheres[number].name for number in (one, other)]
            raise FitFailed(
                "gap of balls that touch [sigma]",
                float(apart[worst]),
                CONTACT_LIMIT,
                f"{names[0]} and {names[1]} touch in the scene file and not in the frames; give fit.contact_mm as"
                " large as their gaps may be, or leave it out",
            )
