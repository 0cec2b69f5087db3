"""The true geometry of the bench from frames of its target.

Stages, each starting from the last:

1. camera on the bare target, all heights: the target at z = 0 defines the world;
2. glass, camera held: saddles paired with lattice corners from several starts (`pairing`), then corners on
   every sheet predicted, measured to sub-pixel and fitted, twice;
3. everything together, all frames: the estimate and its covariance.

Corners weigh by their own sigma, times one factor for each region (direct, behind glass) that makes their
residuals agree with it: behind glass ghosts and curved edges add errors that no single window shows.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from correction.board_search import SATURATED
from correction.corners import saturated_fraction
from correction.errors import FrameError
from correction.fit.contact import largest_overlap_mm, pushed_apart
from correction.fit.errors import FitFailed, GlassNotSeen, ViewsMissing
from correction.fit.measurement import MeasuredFrame, TargetFrame, bare_frame, glass_frame, whitening
from correction.fit.pairing import Candidates, candidates_of, pair
from correction.fit.solver import Corners, Residuals, Solution, minimise, residuals
from correction.fit.unknowns import Bench, bench_of
from correction.saddles import find_saddles
from correction.target import Chessboard
from tracer.fit_section import FitTable
from tracer.scene import Scene
from tracer.sensitivity import SPHERE

KNEE = 3.0  # sigmas at which a corner begins to lose its say
OUTLIER = 5.0  # sigmas at which it has none
PASSES = 2
RMS_LIMIT_PX = 0.3
SHARE_LIMIT = 0.75
OVERLAP_LIMIT_MM = 0.02
PRIOR_LIMIT = 5.0


def _silent(text: str) -> None:
    """Say nothing."""


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
    behind, inlier : (N,) bool
        Seen through glass; used by the fit.
    rim_px : (N,) float64
        Distance to the border of the branch.
    """

    frame: NDArray[np.int64]
    index: NDArray[np.int64]
    pixel: NDArray[np.float64]
    residual_px: NDArray[np.float64]
    behind: NDArray[np.bool_]
    inlier: NDArray[np.bool_]
    rim_px: NDArray[np.float64]

    def rms_px(self, behind: bool) -> NDArray[np.float64]:
        """Root mean square residual per axis (2,) of the inliers of a region."""
        chosen = self.inlier & (self.behind == behind)
        return np.asarray(np.sqrt((self.residual_px[chosen] ** 2).mean(axis=0)))


@dataclass(frozen=True)
class SceneFit:
    """A fitted scene and how sure it is.

    Parameters
    ----------
    scene : Scene
        The fitted scene.
    bench : Bench
        What was free, around the nominal scene.
    x : (P,) float64
        The free vector in units of the prior's sigmas.
    covariance : (P, P) float64
        Of x.
    normal : (P, P) float64
        Normal matrix of the data alone.
    frames : tuple of str
        Names of the frames.
    corners : FittedCorners
        Every corner.
    expected_behind, paired_behind : int
        Corners behind glass that the fitted scene shows, and those measured and used.
    refused : dict
        Reason -> corners that could not be measured.
    pushed_mm : float
        Overlap removed at the end.
    history : tuple of str
        What happened, one line a step.
    """

    scene: Scene
    bench: Bench
    x: NDArray[np.float64]
    covariance: NDArray[np.float64]
    normal: NDArray[np.float64]
    frames: tuple[str, ...]
    corners: FittedCorners
    expected_behind: int
    paired_behind: int
    refused: dict[str, int]
    pushed_mm: float
    history: tuple[str, ...] = field(default=())

    @property
    def names(self) -> tuple[str, ...]:
        """Free numbers."""
        return self.bench.names

    @property
    def values(self) -> NDArray[np.float64]:
        """Fitted values (P,) in the units of their names: mm, rad, px."""
        full = self.bench.full(self.x)
        first = np.argmax(self.bench.columns != 0.0, axis=0)
        return np.asarray(full[first])

    @property
    def sigmas(self) -> NDArray[np.float64]:
        """Standard deviations (P,) of `values`."""
        return np.asarray(self.bench.sigma * np.sqrt(np.diag(self.covariance)))

    @property
    def share(self) -> float:
        """Share of the visible corners behind glass that were measured and used."""
        return self.paired_behind / max(self.expected_behind, 1)


def fit_scene(
    nominal: Scene,
    frames: Sequence[TargetFrame],
    board: Chessboard,
    priors: FitTable | None = None,
    say: Callable[[str], None] = _silent,
) -> SceneFit:
    """Fit the scene to frames of the target.

    Parameters
    ----------
    nominal : Scene
        What is believed before.
    frames : sequence of TargetFrame
        At least one bare target at height 0, and one with glass if the scene has any.
    board : Chessboard
        The target.
    priors : FitTable, optional
        How far the nominal numbers are trusted.
    say : callable
        Told what happens, one line a step.

    Returns
    -------
    SceneFit

    Raises
    ------
    ViewsMissing, GlassNotSeen, TargetNotFound, FrameError
        The frames cannot determine the scene.
    FitFailed
        The best fit is not good enough.
    """
    work = _Fit(nominal, frames, board, priors or FitTable(), say)
    work.camera()
    if work.glass_frames:
        work.glass()
    return work.joint()


class _Fit:
    """State of a fit between its stages."""

    def __init__(
        self,
        nominal: Scene,
        frames: Sequence[TargetFrame],
        board: Chessboard,
        priors: FitTable,
        say: Callable[[str], None],
    ) -> None:
        self.bare_frames = sorted((f for f in frames if not f.glass), key=lambda f: abs(f.height_mm))
        self.glass_frames = sorted((f for f in frames if f.glass), key=lambda f: abs(f.height_mm))
        if not self.bare_frames or self.bare_frames[0].height_mm != 0.0:
            raise ViewsMissing("a frame of the bare target at z = 0 is needed: it defines the world; take one")
        if nominal.spheres and not self.glass_frames:
            raise ViewsMissing("the scene has spheres but no frame shows the target through them; take one")
        for frame in frames:
            share = saturated_fraction(frame.image)
            if share > SATURATED:
                raise FrameError(
                    f"{frame.name}: {100.0 * share:.0f} % of the pixels are saturated, which displaces every edge;"
                    " expose shorter or close the aperture"
                )
        self.board, self.say, self.history = board, say, list[str]()
        heights = [f.height_mm for f in frames]
        bare_heights = len({f.height_mm for f in self.bare_frames})
        self.bench = bench_of(nominal, heights, priors, focal_free=bare_heights >= 3)
        self.full = self.bench.start
        self.bare: list[MeasuredFrame] = []
        self.behind: list[MeasuredFrame] = []
        self.scales = {False: 1.0, True: 1.0}

    def note(self, text: str) -> None:
        """Remember a line of the history and say it."""
        self.history.append(text)
        self.say(text)

    def height(self, frame: TargetFrame) -> int:
        """Number of a frame's height."""
        return int(np.argmin(np.abs(np.array(self.bench.heights_mm) - frame.height_mm)))

    def camera(self) -> None:
        """Stage 1."""
        bench = self.bench.only(("camera.", "target"))
        for frame in self.bare_frames:
            self.bare.append(bare_frame(frame, self.board, bench.camera(self.full), self.height(frame)))
            solution = self.solve(bench, bench.free(self.full), self.bare)
            self.full = bench.full(solution.x)
            self.note(
                f"camera on {frame.name}: {len(self.bare[-1])} corners, {self.rms(bench, solution, self.bare)}"
            )
        rms = float(np.sqrt(np.mean(self.reprojection(bench, solution.x, self.bare) ** 2)))
        self.check_camera(rms, float(np.abs(solution.x[: len(bench.names)]).max()), bench, solution)

    def check_camera(self, rms_px: float, pull: float, bench: Bench, solution: Solution) -> None:
        """Refuse a camera that does not fit the bare target."""
        if not rms_px <= RMS_LIMIT_PX:
            raise FitFailed(
                "bare target",
                rms_px,
                RMS_LIMIT_PX,
                "the corners of the bare target do not fit any camera near the nominal one; check square_mm, free"
                " more lens terms in the fit section, or check that the board is flat",
            )
        if pull > PRIOR_LIMIT:
            name = bench.names[int(np.argmax(np.abs(solution.x)))]
            raise FitFailed(
                "camera prior",
                pull,
                PRIOR_LIMIT,
                f"{name} would have to be off by {pull:.1f} of its sigmas; check square_mm and the camera section"
                " of the scene, or allow more in its fit section",
            )

    def glass(self) -> None:
        """Stage 2."""
        prefixes = [f"{sphere.name}." for sphere in self.bench.scene.spheres] + ["glass "]
        bench = self.bench.around(self.full).only(prefixes)
        self.pair(bench)
        for number in range(PASSES):
            self.measure_glass(only_behind=number < PASSES - 1)
            behind = [_behind(frame) for frame in self.behind]
            solution = self.solve(bench, bench.free(self.full), behind)
            self.full = bench.full(solution.x)
            count = sum(len(frame) for frame in behind)
            self.note(f"glass, pass {number + 1}: {count} corners, {self.rms(bench, solution, behind)}")

    def pair(self, bench: Bench) -> None:
        """Find out which corner each saddle shows."""
        coarse = bench.only([f"{s.name}.{part}" for s in bench.scene.spheres for part in "xyz"] + ["glass "])
        frame = self.glass_frames[0]
        candidates = candidates_of(find_saddles(frame.image), coarse, self.full, self.height(frame), self.board)
        self.check_glass(frame, candidates)
        camera = coarse.camera(self.full)
        pitch = camera.position_mm[2] / camera.focal_px
        found = pair(coarse, self.full, [candidates], self.board, pitch)
        best = found[0]
        self.full = coarse.full(best.solution.x)
        self.note(
            f"pairing on {frame.name}: {best.inliers} of {best.candidates} saddles, rms {best.rms_px:.2f} px,"
            f" {len(found)} start(s)"
        )

    def check_glass(self, frame: TargetFrame, candidates: Candidates) -> None:
        """Refuse a frame in which the lattice goes on undisturbed where the glass should be."""
        inside, undisturbed = candidates.inside, candidates.inside & candidates.bare
        if not inside.any() or undisturbed.sum() > 0.9 * inside.sum():
            raise GlassNotSeen(
                f"{frame.name}: {int(undisturbed.sum())} of {int(inside.sum())} corners where the spheres should"
                " be lie on the bare lattice; give a frame that shows the target through the glass, or correct the"
                " scene"
            )

    def measure_glass(self, only_behind: bool) -> None:
        """Predict and measure the corners of all frames with glass."""
        scene, _ = legal_scene(self.bench, self.full)
        self.behind = [
            glass_frame(
                frame,
                self.board,
                scene,
                self.bench.pose(self.full, self.height(frame)),
                self.height(frame),
                only_behind,
            )
            for frame in self.glass_frames
        ]
        if not any(_behind(frame).index.size for frame in self.behind):
            raise GlassNotSeen("no corner behind glass could be measured; check focus, light and the scene")

    def joint(self) -> SceneFit:
        """Stage 3."""
        measured = [*self.bare, *self.behind]
        solution = self.solve(self.bench, self.bench.free(self.full), measured)
        kept = [self.inliers(self.bench, solution.x, frame) for frame in measured]
        used = [_taken(frame, which) for frame, which in zip(measured, kept, strict=True)]
        solution = self.solve(self.bench, solution.x, used)
        self.full = self.bench.full(solution.x)
        self.note(f"all together: {self.rms(self.bench, solution, used)}")
        scene, pushed = legal_scene(self.bench, self.full)
        covariance = np.asarray(np.linalg.inv(solution.normal + np.eye(len(solution.x))), dtype=np.float64)
        corners = self.corners(solution.x, measured, kept)
        fit = SceneFit(
            scene,
            self.bench,
            solution.x,
            covariance,
            solution.normal,
            tuple(frame.name for frame in measured),
            corners,
            sum(frame.expected_behind for frame in self.behind),
            int(np.count_nonzero(corners.behind & corners.inlier)),
            _counts(measured),
            pushed,
            tuple(self.history),
        )
        check(fit)
        return fit

    def solve(self, bench: Bench, x: NDArray[np.float64], frames: Sequence[MeasuredFrame]) -> Solution:
        """Fit measured corners; then again with the sigmas that their residuals ask for."""
        for _ in range(2):
            data = [self.weighted(frame) for frame in frames]

            def evaluate(at: NDArray[np.float64], data: list[Corners] = data) -> list[Residuals]:
                return [residuals(bench, at, corners) for corners in data]

            solution = minimise(bench, evaluate, x, knee=KNEE)
            x = solution.x
            self.rescale(frames, evaluate(x))
        return solution

    def weighted(self, frame: MeasuredFrame) -> Corners:
        """Corners with their present sigmas."""
        scale = np.where(frame.behind, self.scales[True], self.scales[False])
        return replace(frame.corners, whiten=whitening(frame.sigma_px, scale))

    def rescale(self, frames: Sequence[MeasuredFrame], parts: Sequence[Residuals]) -> None:
        """Let the median residual of each region be what its sigmas say (Rayleigh: median r^2 = 2 ln 2)."""
        square = np.concatenate([(part.value**2).sum(axis=1) for part in parts])
        behind = np.concatenate([frame.behind for frame in frames])
        for region in (False, True):
            chosen = square[(behind == region) & np.isfinite(square)]
            if len(chosen) > 20:
                self.scales[region] *= float(np.sqrt(np.median(chosen) / (2.0 * np.log(2.0))))

    def reprojection(
        self, bench: Bench, x: NDArray[np.float64], frames: Sequence[MeasuredFrame]
    ) -> NDArray[np.float64]:
        """Residuals (N, 2) in raw px."""
        eye = [replace(f.corners, whiten=np.broadcast_to(np.eye(2), (len(f), 2, 2))) for f in frames]
        return np.concatenate([residuals(bench, x, corners).value for corners in eye])

    def rms(self, bench: Bench, solution: Solution, frames: Sequence[MeasuredFrame]) -> str:
        """Median distance and rms within the outlier limit, in words."""
        off = np.linalg.norm(self.reprojection(bench, solution.x, frames), axis=1)
        middle = float(np.nanmedian(off))
        near = off[off < OUTLIER * middle]
        per_axis = float(np.sqrt(np.mean(near**2) / 2.0))
        return f"rms {per_axis:.3f} px per axis, {len(off) - len(near)} beyond {OUTLIER:g} sigma"

    def inliers(self, bench: Bench, x: NDArray[np.float64], frame: MeasuredFrame) -> NDArray[np.bool_]:
        """Corners within OUTLIER sigmas."""
        value = residuals(bench, x, self.weighted(frame)).value
        return np.asarray(np.linalg.norm(value, axis=1) < OUTLIER)  # False for NaN

    def corners(
        self, x: NDArray[np.float64], measured: Sequence[MeasuredFrame], kept: Sequence[NDArray[np.bool_]]
    ) -> FittedCorners:
        """Every corner with its residual."""
        return FittedCorners(
            np.concatenate([np.full(len(frame), number) for number, frame in enumerate(measured)]),
            np.concatenate([frame.index for frame in measured]),
            np.concatenate([frame.corners.pixel for frame in measured]),
            self.reprojection(self.bench, x, measured),
            np.concatenate([frame.behind for frame in measured]),
            np.concatenate(list(kept)),
            np.concatenate([frame.rim_px for frame in measured]),
        )


def check(fit: SceneFit) -> None:
    """Hold a fit against its gates.

    Raises
    ------
    FitFailed
        Naming gate, value and limit.
    """
    cure = "check that the scene lists every sphere, its radius and glass, and that nothing moved between frames"
    if fit.corners.behind.any():
        rms = float(fit.corners.rms_px(behind=True).max())
        if not rms <= RMS_LIMIT_PX:
            raise FitFailed("rms behind glass [px]", rms, RMS_LIMIT_PX, cure)
        if fit.share < SHARE_LIMIT:
            raise FitFailed("share of visible corners paired", fit.share, SHARE_LIMIT, cure)
    if fit.pushed_mm > OVERLAP_LIMIT_MM:
        raise FitFailed("overlap of bodies [mm]", fit.pushed_mm, OVERLAP_LIMIT_MM, cure)
    pull = float(np.abs(fit.x).max(initial=0.0))
    if pull > PRIOR_LIMIT:
        name = fit.names[int(np.argmax(np.abs(fit.x)))]
        text = f"{name} had to move that many of its sigmas; check its value, or allow more in the fit section"
        raise FitFailed("distance from the prior [sigma]", pull, PRIOR_LIMIT, text)


def legal_scene(bench: Bench, full: NDArray[np.float64]) -> tuple[Scene, float]:
    """Return the scene of a full vector with overlaps pushed apart, and the largest overlap [mm]."""
    spheres = bench.spheres(full)
    overlap = largest_overlap_mm(spheres)
    moved = np.array(full)
    moved[bench.glass].reshape(-1, len(SPHERE))[:, :3] = pushed_apart(spheres)[:, :3]
    return bench.moved(moved), overlap


def _behind(frame: MeasuredFrame) -> MeasuredFrame:
    return _taken(frame, frame.behind)


def _taken(frame: MeasuredFrame, which: NDArray[np.bool_]) -> MeasuredFrame:
    """Return the frame with the chosen corners."""
    return replace(
        frame,
        corners=frame.corners.take(which),
        index=frame.index[which],
        behind=frame.behind[which],
        rim_px=frame.rim_px[which],
        sigma_px=frame.sigma_px[which],
    )


def _counts(frames: Sequence[MeasuredFrame]) -> dict[str, int]:
    """Sum of the refusals of all frames."""
    total: dict[str, int] = {}
    for frame in frames:
        for reason, count in frame.refused.items():
            total[reason] = total.get(reason, 0) + count
    return total
