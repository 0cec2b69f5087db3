"""From measured corners to estimate and covariance.

Corners weigh by their own sigma, times one factor for each region (direct, behind glass) that makes the
median residual agree with it: behind glass ghosts and curved edges add errors that no single window shows.
The free vector x (P,) holds the numbers that are fitted, in units of their prior sigmas; the full vector (F,)
every number of the scene in mm, rad or px, free or fixed.  The lock is the pixel locking of corners
(`pixel_lock`): its terms are fitted with x, and move nothing in the scene. Corners beyond OUTLIER sigmas are
rejected and reported; those beyond CAUCHY_SIGMAS weigh less and less.  The covariance is (N + P)^-1 in units of
the prior's sigmas, N the normal matrix of the corners used and P the identity, or less where priors have failed
their joint test.  Errors that corners have in common are added to it.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from correction.fit.judge.prior_pulls import LENGTHS, length_errors, prior_pulls, widen_priors
from correction.fit.judge.result import FitStep, FittedCorners, SceneFit
from correction.fit.judge.verdict import ResidualsGivenCause, judge_model
from correction.fit.seen.measurement import MeasuredFrame, by_region, region_factors, whitening
from correction.fit.seen.pixel_lock import NAMES as LOCK
from correction.fit.seen.pixel_lock import PixelLock, remove_lock, with_lock, without_lock
from correction.fit.solve.considered import (
    SIZES_MM,
    ShapeRoot,
    likely_scale,
    shape_parts,
    shapes_to_consider,
    with_considered,
    with_shapes,
)
from correction.fit.solve.contact import largest_overlap_mm
from correction.fit.solve.correlation import with_correlation
from correction.fit.solve.print_errors import OnPrint, print_errors
from correction.fit.solve.solver import (
    Corners,
    Residuals,
    Solution,
    clear_spheres,
    minimise,
    newton_step,
    normal_equations,
    residuals,
)
from correction.fit.solve.unknowns import Unknowns
from tracer.scene.scene import Scene

CAUCHY_SIGMAS = 3.0  # sigmas beyond which a corner weighs less and less
OUTLIER = 5.0  # sigmas beyond which it weighs nothing
# Sigmas: knee of a Cauchy loss that weighs every corner in full
FULL_WEIGHT = 1e6


class Adjustment:
    """Weighs measured corners and fits them; keeps the factor of each region's sigma between fits."""

    def __init__(self) -> None:
        self.scales = {False: 1.0, True: 1.0}
        self.lock = np.zeros(len(LOCK))

    def solve(self, unknowns: Unknowns, x: NDArray[np.float64], frames: Sequence[MeasuredFrame]) -> Solution:
        """Fit measured corners; then again with the sigmas that their residuals ask for."""
        locked, at = with_lock(unknowns), np.concatenate((x, self.lock))
        locks = [PixelLock.of(frame) for frame in frames]
        for _ in range(2):
            data = [self.weigh_corners(frame) for frame in frames]

            def evaluate(at: NDArray[np.float64], data: list[Corners] = data) -> list[Residuals]:
                pairs = zip(data, locks, strict=True)
                return [remove_lock(locked, at, one, lock, residuals(locked, at, one)) for one, lock in pairs]

            solution = minimise(locked, evaluate, at, knee=CAUCHY_SIGMAS)
            at = solution.x
            self.rescale(frames, evaluate(at))
        self.lock = at[len(x) :]
        return replace(solution, x=at[: len(x)], normal=without_lock(locked, solution.normal))

    def frame_residuals(
        self,
        unknowns: Unknowns,
        x: NDArray[np.float64],
        frame: MeasuredFrame,
        corners: Corners | None = None,
    ) -> Residuals:
        """Residuals of a frame as weighted, or of its corners with other weights, the lock on pixels taken off."""
        locked, at = with_lock(unknowns), np.concatenate((x, self.lock))
        corners = corners or self.weigh_corners(frame)
        return remove_lock(locked, at, corners, PixelLock.of(frame), residuals(locked, at, corners))

    def weigh_corners(self, frame: MeasuredFrame) -> Corners:
        """Corners with their present sigmas."""
        return replace(frame.corners, whiten=whitening(frame.sigma_px, by_region(frame.behind, self.scales)))

    def rescale(self, frames: Sequence[MeasuredFrame], parts: Sequence[Residuals]) -> None:
        """Let the median residual of each region be what its sigmas say; those of a level in shadow are bounds."""
        values = [
            np.where(frame.in_shadow[:, None], np.nan, part.value)
            for frame, part in zip(frames, parts, strict=True)
        ]
        factors = region_factors([frame.behind for frame in frames], values)
        self.scales = {region: scale * factors[region] for region, scale in self.scales.items()}

    def reprojection(
        self, unknowns: Unknowns, x: NDArray[np.float64], frames: Sequence[MeasuredFrame]
    ) -> NDArray[np.float64]:
        """Residuals (N, 2) in raw px."""
        eye = [replace(f.corners, whiten=np.broadcast_to(np.eye(2), (len(f), 2, 2))) for f in frames]
        parts = [
            self.frame_residuals(unknowns, x, frame, corners) for frame, corners in zip(frames, eye, strict=True)
        ]
        return np.concatenate([part.value for part in parts])

    def step(
        self,
        name: str,
        unknowns: Unknowns,
        x: NDArray[np.float64],
        frames: Sequence[MeasuredFrame],
        kept: Sequence[NDArray[np.bool_]] | None = None,
    ) -> FitStep:
        """Say how well frames are fitted: rms per axis of the corners that are not rejected."""
        off = self.reprojection(unknowns, x, frames)
        near = np.concatenate(kept or [self.inliers(unknowns, x, frame) for frame in frames])
        per_axis = float(np.sqrt(np.mean(off[near] ** 2))) if near.any() else float("nan")
        return FitStep(
            name, len(off), per_axis, f"{len(off) - np.count_nonzero(near)} rejected beyond {OUTLIER:g} sigma"
        )

    def inliers(self, unknowns: Unknowns, x: NDArray[np.float64], frame: MeasuredFrame) -> NDArray[np.bool_]:
        """Corners within OUTLIER sigmas."""
        value = self.frame_residuals(unknowns, x, frame).value
        return np.asarray(np.linalg.norm(value, axis=1) < OUTLIER)  # False for NaN

    def corners(
        self,
        unknowns: Unknowns,
        x: NDArray[np.float64],
        measured: Sequence[MeasuredFrame],
        kept: Sequence[NDArray[np.bool_]],
    ) -> FittedCorners:
        """Every corner with its residual."""
        return FittedCorners(
            np.concatenate([np.full(len(frame), number) for number, frame in enumerate(measured)]),
            np.concatenate([frame.index for frame in measured]),
            np.concatenate([frame.corners.pixel for frame in measured]),
            self.reprojection(unknowns, x, measured),
            np.concatenate([frame.branch_name for frame in measured]),
            np.concatenate(list(kept)),
            np.concatenate([frame.rim_px for frame in measured]),
        )

    def common_mode_gradients(
        self, frames: Sequence[MeasuredFrame], parts: Sequence[Residuals]
    ) -> NDArray[np.float64]:
        """Return J^T W e (P, K) of K errors e that corners share: by colours, pupil, the bending of each branch.

        (N + P)^-1 times a column is the error of the estimate by one standard deviation of that cause.
        """
        pulls: dict[str, NDArray[np.float64]] = {}
        for frame, part in zip(frames, parts, strict=True):
            whiten, rate = np.asarray(self.weigh_corners(frame).whiten), np.nan_to_num(part.rate)
            causes = {"colours": frame.smear_px[:, 0], "pupil": frame.smear_px[:, 1]}
            for way in np.unique(frame.branch_name).tolist():
                causes[f"way {way}"] = frame.bent_px * (frame.branch_name == way)[:, None]
            for cause, off in causes.items():
                if off.any():
                    pull = np.einsum("nip,nij,nj->p", rate, whiten, off, optimize=True)
                    pulls[cause] = pulls.get(cause, 0.0) + pull
        return np.column_stack([np.zeros((parts[0].rate.shape[2], 0)), *pulls.values()])

    def estimate(
        self,
        unknowns: Unknowns,
        full: NDArray[np.float64],
        measured: Sequence[MeasuredFrame],
        history: Sequence[FitStep],
    ) -> SceneFit:
        """Fit everything that is free to everything measured, starting from a full vector (F,).

        The uncertainty is a consider covariance (Schmidt 1966): numbers that are held, and shapes of balls, are
        not estimated, but their prior uncertainty is carried through the same normal equations.  Its root is built
        of columns, one independent error each, in an order that matters: a cause of residuals first, since it sets
        the weights of all that follows; the size of shapes next, which counts only where no cause is named; then
        priors that fail their joint test, which widen the covariance; at last what all corners have in common.

        Parameters
        ----------
        unknowns : Unknowns
            Free numbers, their priors, and the scene around which they are counted.
        full : (F,) float64
            Full vector to start from.
        measured : sequence of MeasuredFrame
            Measured corners of all frames.
        history : sequence of FitStep
            Earlier steps of the fit, for the report.
        """
        # Fit, reject outliers, fit again: outliers of the first fit would bend the second.
        solution = self.solve(unknowns, unknowns.free(full), measured)
        kept = [self.inliers(unknowns, solution.x, frame) for frame in measured]
        used = [frame.take(which) for frame, which in zip(measured, kept, strict=True)]
        solution = self.solve(unknowns, solution.x, used)
        # Order of the vector `at`: free numbers and lock, held numbers of the glass, shapes of balls.  The last
        # two are the consider parameters; they stay 0.
        locked, balls = with_lock(unknowns), shapes_to_consider(unknowns)
        wide, free = with_shapes(with_considered(locked), balls), len(locked.names)
        at = np.concatenate((solution.x, self.lock, np.zeros(len(wide.names) - free)))
        parts = [self.full_residuals(unknowns, wide, at, frame) for frame in used]
        every = [self.full_residuals(unknowns, wide, at, frame) for frame in measured]
        weighted = [self.weigh_corners(frame) for frame in measured]
        verdict, given = judge_model(locked, wide, at, measured, weighted, every)
        weights = self
        if verdict.unexplained is not None:  # corners err by what the cause leaves, not by its field
            weights, used, parts = self.reweight_given_cause(measured, every, given)
        # The Cauchy loss halves the weight of good corners at its knee; the covariance counts their information
        # in full.
        _, gradient, normal = normal_equations(wide, at, parts, FULL_WEIGHT)
        gradient = marginal_gradient(gradient, normal, free)
        # Shapes count in the size that the frames make likely (empirical Bayes), or not at all beside an alarm,
        # whose cause is counted by itself.  `unit` (P,): new prior sigma of each number over the old one.
        first_shape = len(at) - len(SIZES_MM) * len(balls)
        unit = np.ones(len(at))
        unit[first_shape:] = 0.0 if verdict.alarms else likely_scale(normal, gradient, len(at) - first_shape)
        gradient, normal = gradient * unit, normal * np.outer(unit, unit)
        lattices = [replace(lattice, rate=lattice.rate * unit) for lattice in given.lattices]
        # Priors are tested jointly as they are given, unless an alarm has a named cause; those that fail are
        # widened (Birge's ratio).
        inverse = np.asarray(np.linalg.inv(normal + np.eye(len(at))), dtype=np.float64)
        if verdict.cause is None or not verdict.alarms:
            spread = with_correlation(inverse, lattices, given.correlation)
            pulls = prior_pulls(unknowns, solution.x, normal[:free, :free], spread)
            if verdict.cause is None:
                verdict = replace(verdict, pulls=pulls)
            elif pulls and pulls[0].kind == LENGTHS and pulls[0].sigmas ** 2 > verdict.cause.gain:
                # One scale of all lengths explains more chi-square than the cause, and replaces it.
                verdict = replace(verdict, pulls=pulls, suspects=())
        prior, prior_step = widen_priors(unknowns, solution.x, verdict.pulls, len(at))
        inverse = np.asarray(np.linalg.inv(normal + np.diag(prior)), dtype=np.float64)
        on_print = [weights.on_print(frame, part, unit) for frame, part in zip(used, parts, strict=True)]
        printed = print_errors(on_print)
        covariance = with_correlation(inverse, lattices, given.correlation)
        covariance = covariance + inverse @ printed.spread @ inverse
        # One independent error in each column (P, R).  Those behind the root of the covariance have a known
        # direction: the Newton step to which residuals pull the consider parameters and which the fit does not
        # make, errors that all corners share, and the step that widened priors would allow.
        step = [newton_step(wide, at, gradient, normal)] if len(at) > free else []
        shared = unit[:, None] * weights.common_mode_gradients(used, parts)
        errors = np.column_stack((root_of(covariance), *step, inverse @ shared, inverse @ prior_step))
        # From prior sigmas to mm, rad, px of the full vector; shapes, which it does not hold, have a root of their
        # own.
        root = wide.columns @ errors
        sizes = (unit[first_shape:] * np.tile(SIZES_MM, len(balls)))[:, None]
        shapes = ShapeRoot(balls, sizes * errors[first_shape:])
        # Errors of the full vector itself: by the cause of an alarm, then by a common scale of all lengths.
        for change, (ball, shape) in zip(verdict.changes, verdict.shapes, strict=True):
            root, shapes = np.column_stack((root, change)), shapes.with_columns(change.shape[1])
            shapes = shapes.with_change(ball, shape)
        scale = length_errors(unknowns, solution.x, verdict.pulls)
        root, shapes = np.column_stack((root, scale)), shapes.with_columns(scale.shape[1])
        scene, pushed = feasible_scene(unknowns, unknowns.full(solution.x))
        found = [FitStep(str(printed))] if str(printed) else []
        return SceneFit(
            scene=scene,
            unknowns=unknowns,
            x=solution.x,
            covariance=covariance[: len(solution.x), : len(solution.x)],
            normal=without_lock(locked, normal[:free, :free]),
            root=root,
            frames=tuple(frame.name for frame in measured),
            corners=self.corners(unknowns, solution.x, measured, kept),
            expected=_sum_counts([frame.expected for frame in measured]),
            refused=_sum_counts([frame.refused for frame in measured]),
            pushed_mm=pushed,
            # In the same light, until `light` corrects for that of the target frames
            measured_scene=scene,
            verdict=verdict,
            history=(*history, *found, self.step("all together", unknowns, solution.x, measured, kept)),
            shapes=shapes,
        )

    def reweight_given_cause(
        self, measured: Sequence[MeasuredFrame], parts: Sequence[Residuals], given: ResidualsGivenCause
    ) -> tuple["Adjustment", list[MeasuredFrame], list[Residuals]]:
        """Return weights, frames and residuals of a fit that had known the cause of an alarm."""
        weights = Adjustment()
        weights.scales = {region: scale * given.factors[region] for region, scale in self.scales.items()}
        weights.lock = self.lock
        used, left = [], []
        for frame, part, value in zip(measured, parts, given.values, strict=True):
            scale = by_region(frame.behind, given.factors)[:, None]
            value = value / scale
            near = np.linalg.norm(value, axis=1) < OUTLIER  # False for NaN
            near &= np.isfinite(part.rate).all(axis=(1, 2))  # a ray that meets the board with the cause alone
            used.append(frame.take(near))
            left.append(Residuals(value[near], (part.rate / scale[:, :, None])[near]))
        return weights, used, left

    def on_print(self, frame: MeasuredFrame, part: Residuals, unit: NDArray[np.float64]) -> OnPrint:
        """Corners of a frame as the print moves them, their derivatives in units (P,)."""
        per_square = np.asarray(self.weigh_corners(frame).whiten) @ frame.axes_px
        rate = np.nan_to_num(part.rate) * unit
        way, height = frame.branch_name, frame.corners.height_number
        return OnPrint(frame.index, way, height, np.nan_to_num(part.value), per_square, rate)

    def full_residuals(
        self, unknowns: Unknowns, wide: Unknowns, at: NDArray[np.float64], frame: MeasuredFrame
    ) -> Residuals:
        """Residuals of a frame with derivatives by free numbers, then by consider parameters, shapes last."""
        corners = self.weigh_corners(frame)
        part = remove_lock(wide, at, corners, PixelLock.of(frame), residuals(wide, at, corners))
        return shape_parts(unknowns, wide.full(at), corners, frame.branch_name, part)


def marginal_gradient(slope: NDArray[np.float64], normal: NDArray[np.float64], free: int) -> NDArray[np.float64]:
    """Gradient (P,) by the consider parameters c, the first `free` numbers eliminated (Schur complement).

    g_c - N_cf (N_ff + 1)^-1 g_f, and 0 by the free numbers: the fit has minimised a loss that weighs distant
    corners less, so the gradient of the full squares is not 0 there, and would be counted as an error.
    """
    followed = np.linalg.solve(normal[:free, :free] + np.eye(free), slope[:free])
    return np.concatenate((np.zeros(free), slope[free:] - normal[free:, :free] @ followed))


def root_of(covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return R (P, P) with R R^T the covariance (P, P), whose smallest eigenvalues may be lost in rounding."""
    values, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T))
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def feasible_scene(unknowns: Unknowns, full: NDArray[np.float64]) -> tuple[Scene, float]:
    """Return the scene of a full vector with overlaps pushed apart, and the largest overlap [mm]."""
    overlap = largest_overlap_mm(unknowns.spheres(full), unknowns.shapes(full))
    moved, cut = clear_spheres(unknowns, full)
    return unknowns.scene_at(moved), max(overlap, cut)


def _sum_counts(counts: Sequence[dict[str, int]]) -> dict[str, int]:
    """Sum counts by their names."""
    total: Counter[str] = Counter()
    for one in counts:
        total.update(one)
    return dict(total)
