"""The true geometry of the bench from frames of its target.

Stages, each starting from the last:

1. camera on the bare target, all heights: the target at z = 0 defines the world; with walls that stand there,
   corners are then measured where the scene shows them, twice;
2. glass, camera held: saddles paired with lattice corners from several starts (`pairing`), then corners on
   every sheet predicted, measured to sub-pixel and fitted, twice;
3. everything together, all frames: the estimate and its covariance (`adjustment`).

A fit that misses a gate is raised as FitFailed with the gate, what was reached and what is needed.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from correction.errors import FitFailed, GlassNotSeen, ViewsMissing
from correction.fit.adjustment import Adjustment, legal_scene
from correction.fit.judge.result import SHARE_LIMIT, FitStep, SceneFit, check, rms_limit_px
from correction.fit.judge.suspects import CLEAR
from correction.fit.judge.unconfirmed import unconfirmed_ways
from correction.fit.judge.verdict import PRIOR_LIMIT
from correction.fit.seen.lost_sphere import likely_places, lost_spheres
from correction.fit.seen.measurement import (
    FLOOR_PX,
    MeasuredFrame,
    TargetFrame,
    bare_frame,
    bare_frame_through_walls,
    glass_frame,
)
from correction.fit.seen.pairing import Candidates, candidates_of, pair
from correction.fit.seen.prediction import LEAST_SQUARE_PX, square_behind_px
from correction.fit.seen.silhouettes import Outlines, followed, seen_outlines
from correction.fit.seen.smear import Dispersion
from correction.fit.seen.unlisted import unlisted_parts
from correction.fit.solve.board_pose import in_words, turn_of_bench, turned
from correction.fit.solve.light import Rival, any_lamp, back_from_light, doubt_of, in_light
from correction.fit.solve.solver import Solution
from correction.fit.solve.unknowns import Unknowns, unknowns_of
from correction.target import Chessboard
from correction.target.board_search import SATURATED
from correction.target.corners import saturated_fraction
from correction.target.lattice_growth import Saddles, find_saddles
from piv.errors import FrameError
from tracer.camera import Vector3
from tracer.light import Light
from tracer.scene.fit_section import FitTable
from tracer.scene.scene import Scene
from tracer.strategies.branches import branch_of
from tracer.strategies.sensitivity import SPHERE

WEAKEST = 0.01  # saddles behind glass are this strong, compared to the bare target, or noise
FEWEST = 12  # corners behind glass from which a fit may begin
ASIDE_MM = 1.0  # a ball whose rim is seen farther than this from its place, or than FOLLOW sigmas, is followed
FOLLOW = 1.0
BESIDE = 0.8  # squares: rims are seen to a few tenths of one
DEPTH_MM = 3.0  # what is known of the depth of a ball that does not stand where it was said to
HOPELESS = 0.3  # share of saddles on corners up to which a single lost ball is not what is wrong
LOOKED_THROUGH = 3  # frames in which a lost ball is looked for: few corners of it may be in each
AGAIN, STAYS_MM = 6, 0.02  # times that a place is measured, while corners move the ball that stands there
WORSE, OWN_WORSE = 1.2, 3.0  # times, that corners of others may fit worse than before, and its own than others
FEW_LOST = 0.5  # of the balls: unless fewer are lost once corners are measured, which tells more than saddles do
UNDISTURBED = 0.9  # share of bare-lattice corners inside the glass's outline from which there is no glass
LENS_FREED = {"principal_px": 100.0, "k1": 1.0, "k2": 5.0, "p1": 0.01, "p2": 0.01}  # sigmas that hold any lens
THROUGH_WALLS = 2  # times that corners of the bare target are measured again behind walls


def _silent(text: str) -> None:
    """Say nothing."""


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
    priors, nominal = priors or FitTable(), replace(nominal, masked=())  # judged anew
    light = priors.light.light() if priors.light else None
    work = _Fit(in_light(nominal, light), frames, board, priors, say)
    if light is not None and len(light.weight) > 1:
        work.dispersion = Dispersion.of(nominal, light)
    work.camera()
    if work.glass_frames:
        work.glass()
    fit = work.looked_through(
        work.fits.estimate(work.unknowns, work.full, [*work.bare, *work.behind], work.history)
    )
    say(str(fit.history[-1]))
    try:
        check(fit)
    except FitFailed as failed:
        raise FitFailed(failed.gate, failed.value, failed.limit, work.blamed(failed.reason)) from None
    doubt = doubt_of(nominal, light, _rivals(fit, priors, light))
    measured = replace(back_from_light(fit.scene, nominal, light), masked=fit.verdict.masked)
    return replace(fit, measured_scene=measured, light=doubt)


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
        _refuse_saturated(frames)
        self.board, self.say, self.history = board, say, list[FitStep]()
        self.nominal, self.priors, self.heights = nominal, priors, [f.height_mm for f in frames]
        self.focal_free = len({f.height_mm for f in self.bare_frames}) >= 3
        self.unknowns = unknowns_of(nominal, self.heights, priors, self.focal_free)
        self.full = self.unknowns.start
        self.bare: list[MeasuredFrame] = []
        self.behind: list[MeasuredFrame] = []
        self.fits = Adjustment()
        self.dispersion: Dispersion | None = None
        self.outlines: Outlines | None = None
        self.explained = 0.0
        self.others: list[NDArray[np.float64]] = []
        self.found_saddles: dict[str, Saddles] = {}

    def note(self, step: FitStep) -> None:
        """Remember a step and say it."""
        self.history.append(step)
        self.say(str(step))

    @property
    def walls(self) -> list[str]:
        """Beginnings of the names of numbers of windows and tubes, through which the bare target is seen."""
        return [f"{body.name}." for body in self.nominal.bodies if body.stays]

    def height_number(self, frame: TargetFrame) -> int:
        """Number of a frame's height."""
        return int(np.argmin(np.abs(np.array(self.unknowns.heights_mm) - frame.height_mm)))

    def saddles(self, frame: TargetFrame) -> Saddles:
        """Saddles of a frame, looked for once."""
        if frame.name not in self.found_saddles:
            self.found_saddles[frame.name] = find_saddles(frame.image)
        return self.found_saddles[frame.name]

    def looked_through(self, fit: SceneFit) -> SceneFit:
        """Look in all frames with glass whether they show, and corners confirm, what the fitted scene shows."""
        full = fit.unknowns.full(fit.x)
        views = [
            (frame.name, frame.image, fit.unknowns.pose(full, self.height_number(frame)))
            for frame in self.glass_frames
        ]
        unlisted = unlisted_parts(fit.scene, views, self.board, [frame.index for frame in self.bare])
        sigma = dict(zip(fit.names, fit.sigmas.tolist(), strict=True))
        place = {name[:-2]: size for name, size in sigma.items() if name.endswith(".x")}
        paired = {way: fit.paired(way) for way in fit.expected}
        lost = unconfirmed_ways(fit.scene, fit.expected, paired, place, self.rims_elsewhere(fit.scene))
        return replace(fit, verdict=replace(fit.verdict, unlisted=unlisted, unconfirmed=lost))

    def rims_elsewhere(self, scene: Scene) -> dict[str, Vector3]:
        """Balls of a scene that do not stand where their own rims are seen, with their centres there."""
        if self.outlines is None:
            return {}
        beside = self.outlines.beside(scene, BESIDE * self.board.square_mm).tolist()
        places = zip(self.outlines.names, self.outlines.place_mm.tolist(), beside, strict=True)
        return {name: (x, y, z) for name, (x, y, z), is_beside in places if is_beside}

    def blamed(self, reason: str) -> str:
        """Say what the rims of the balls show, then the reason of a failure."""
        seen = self.outlines.in_words(0.0) if self.outlines else ""
        return f"{seen}; {reason}" if seen else reason

    def camera(self) -> None:
        """Stage 1."""
        unknowns, solution = self.fit_camera(self.bare_frames[:1])
        if _pull(solution) > PRIOR_LIMIT and not self.lens_off_axis():
            unknowns, solution = self.follow_board(unknowns, solution)
        if len(self.bare_frames) > 1:
            unknowns, solution = self.fit_camera(self.bare_frames[1:])
        for _ in range(THROUGH_WALLS if self.walls else 0):
            solution = self.measure_through_walls(unknowns)
        rms = self.bare_rms_px(unknowns, solution.x)
        self.check_camera(rms, _pull(solution), unknowns, solution)

    def bare_rms_px(self, unknowns: Unknowns, x: NDArray[np.float64]) -> float:
        """Residual of the bare target's corners; through walls of those that these show well, if most are."""
        off = self.fits.reprojection(unknowns, x, self.bare)
        kept = np.concatenate([self.fits.inliers(unknowns, x, frame) for frame in self.bare])
        if self.walls and kept.mean() >= SHARE_LIMIT:  # at the edge of a tube the view is squeezed, or lost
            off = off[kept]
        return float(np.sqrt(np.mean(off**2)))

    def fit_camera(self, frames: Sequence[TargetFrame]) -> tuple[Unknowns, Solution]:
        """Find the bare target in more frames, one by one, and fit the camera to all there are."""
        unknowns = self.unknowns.only(("camera.", "target", *self.walls))
        for frame in frames:
            self.bare.append(bare_frame(frame, self.board, unknowns.camera(self.full), self.height_number(frame)))
            solution = self.fits.solve(unknowns, unknowns.free(self.full), self.bare)
            self.full = unknowns.full(solution.x)
            self.note(self.fits.step(f"camera on {frame.name}", unknowns, solution.x, self.bare[-1:]))
        return unknowns, solution

    def measure_through_walls(self, unknowns: Unknowns) -> Solution:
        """Measure the bare target where camera and walls show it, and fit these again."""
        scene = legal_scene(self.unknowns, self.full)[0].bare()
        self.bare = [
            bare_frame_through_walls(
                frame,
                self.board,
                scene,
                self.unknowns.pose(self.full, number := self.height_number(frame)),
                number,
            )
            for frame in self.bare_frames
        ]
        solution = self.fits.solve(unknowns, unknowns.free(self.full), self.bare)
        self.full = unknowns.full(solution.x)
        self.note(self.fits.step("camera through walls", unknowns, solution.x, self.bare))
        return solution

    def follow_board(self, unknowns: Unknowns, solution: Solution) -> tuple[Unknowns, Solution]:
        """Turn the nominal bench as the board shows it turned, if that explains the camera."""
        turn = turn_of_bench(self.nominal.camera, unknowns.camera(self.full), self.priors.camera)
        travel = (float(turn[0, 2]), float(turn[1, 2]), float(turn[2, 2]))
        followed = unknowns_of(turned(self.nominal, turn), self.heights, self.priors, self.focal_free, travel)
        other = followed.only(("camera.", "target", *self.walls))
        again = self.fits.solve(other, np.zeros(len(other.names)), self.bare)
        if _pull(again) > PRIOR_LIMIT:
            return unknowns, solution
        self.unknowns, self.full = followed, other.full(again.x)
        self.note(FitStep(in_words(turn)))
        return other, again

    def lens_off_axis(self) -> str:
        """Say what the bare target shows of the lens if, once its terms are free, a camera as told explains it.

        Terms that are free explain a little of anything: by Schwarz's criterion they must be worth their number.
        """
        free = {name: max(size, getattr(self.priors.camera, name)) for name, size in LENS_FREED.items()}
        camera = self.priors.camera.model_copy(update=free)
        priors = self.priors.model_copy(update={"camera": camera})
        wider = unknowns_of(self.nominal, self.heights, priors, self.focal_free)
        told = self.unknowns.only(("camera.", "target", *self.walls))
        freed = wider.only(("camera.", "target", *self.walls))
        before, after = (Adjustment().solve(one, one.free(one.start), self.bare) for one in (told, freed))
        rms, alone = (self.bare_rms_px(one, fit.x) for one, fit in ((freed, after), (told, before)))
        numbers = 2 * sum(map(len, self.bare))
        gain = 2.0 * numbers * np.log(alone / rms) + float(before.x @ before.x - after.x @ after.x)
        enough = (len(freed.names) - len(told.names)) * np.log(numbers)
        if _pull(after) > PRIOR_LIMIT or rms > self.rms_limit_px() or gain < enough:
            return ""
        new = [name for name in freed.names if name not in told.names]
        values = dict(zip(freed.names, after.x * freed.sigma, strict=True))
        spread = np.sqrt(np.diag(np.linalg.inv(after.normal + np.eye(len(after.x)))))
        sigma = dict(zip(freed.names, freed.sigma * spread, strict=True))
        found = [f"{name} {values[name]:+.2g}" for name in new if abs(values[name]) > CLEAR * sigma[name]]
        return (
            f"the lens is off its axis or distorts more than is told: with its terms free the bare target is where"
            f" the camera shows it, to {rms:.2g} px, and {', '.join(found)} differ from what was held; free"
            f" {', '.join(LENS_FREED)} in fit.camera"
        )

    def rms_limit_px(self) -> float:
        """Largest residual of the bare target that is taken as a fit."""
        sigma = [np.hypot(frame.sigma_px, FLOOR_PX).ravel() for frame in self.bare]
        return rms_limit_px(float(np.nanmedian(np.concatenate(sigma))))

    def check_camera(self, rms_px: float, pull: float, unknowns: Unknowns, solution: Solution) -> None:
        """Refuse a camera that does not fit the bare target."""
        limit = self.rms_limit_px()
        lens = "" if rms_px <= limit and pull <= PRIOR_LIMIT else self.lens_off_axis()
        if not rms_px <= limit:
            raise FitFailed(
                "bare target",
                rms_px,
                limit,
                lens
                or "the corners of the bare target do not fit any camera near the nominal one; check square_mm,"
                " free more lens terms in the fit section, or check that the board is flat",
            )
        if pull > PRIOR_LIMIT:
            name = unknowns.names[int(np.argmax(np.abs(solution.x)))]
            wall = name.rpartition(".")[0] if name.startswith(tuple(self.walls)) else ""
            section = f"{wall!r} among the bodies" if wall else "the camera section"
            raise FitFailed(
                "camera prior",
                pull,
                PRIOR_LIMIT,
                lens
                or f"{name} would have to be off by {pull:.1f} of its sigmas; check square_mm and {section}"
                " of the scene, or allow more in its fit section",
            )

    def glass(self) -> None:
        """Stage 2."""
        self.follow_outlines()
        prefixes = [f"{sphere.name}." for sphere in self.unknowns.scene.spheres] + ["glass "]
        prefixes += [f"{body.name}." for body, _ in self.unknowns.other_bodies.bodies if not body.stays]
        unknowns = self.unknowns.around(self.full).only(prefixes)
        coarse = unknowns.only([f"{s.name}.{part}" for s in unknowns.scene.spheres for part in "xyz"] + ["glass "])
        candidates = self.candidates(coarse, self.glass_frames[0])
        self.check_glass(self.glass_frames[0], candidates)
        self.pair(coarse, candidates)
        self.fit_glass(unknowns, "pass 1", only_behind=True)
        lost = self.lost()
        if lost and (self.explained > HOPELESS or len(lost) < FEW_LOST * len(unknowns.scene.spheres)):
            self.find_all_lost(unknowns, coarse, candidates)
        self.fit_glass(unknowns, "pass 2", only_behind=False)

    def follow_outlines(self) -> None:
        """Put balls whose rims are seen elsewhere where they are seen, and take that for what is known of them."""
        frame = self.glass_frames[0]
        least = WEAKEST * float(np.median(self.saddles(self.bare_frames[0]).strength))
        number = self.height_number(frame)
        saddles = self.saddles(frame)
        self.outlines = seen_outlines(self.unknowns, self.full, self.bare[0], saddles, least, number, self.board)
        if self.outlines is None:
            return
        known = [self.priors.sphere(name).centre_mm for name in self.outlines.names]
        off = self.outlines.surely_off(ASIDE_MM) & (self.outlines.sideways_mm > FOLLOW * np.array(known))
        if off.any():
            self.others = [followed(self.unknowns, self.full, self.outlines, alone=True), self.full]
            self.full = followed(self.unknowns, self.full, self.outlines)
            start = self.unknowns.start.copy()
            start[self.unknowns.glass] = self.full[self.unknowns.glass]
            depths = [f"{name}.z" for name in self.outlines.names]
            self.unknowns = self.unknowns.around(start).loosened(depths, DEPTH_MM)
            self.note(FitStep(f"{self.outlines.in_words(ASIDE_MM)}; glass follows"))

    def fit_glass(self, unknowns: Unknowns, name: str, only_behind: bool) -> None:
        """Measure the corners where the scene shows them, and fit the glass to them."""
        self.measure_glass(only_behind)
        behind = [_behind(frame) for frame in self.behind]
        solution = self.fits.solve(unknowns, unknowns.free(self.full), behind)
        self.full = unknowns.full(solution.x)
        self.note(self.fits.step(f"glass, {name}", unknowns, solution.x, behind))

    def candidates(self, coarse: Unknowns, frame: TargetFrame) -> Candidates:
        """Saddles of a frame that may be seen through glass."""
        least = WEAKEST * float(np.median(self.saddles(self.bare_frames[0]).strength))
        return candidates_of(self.saddles(frame), least, coarse, self.full, self.height_number(frame), self.board)

    def pair(self, coarse: Unknowns, candidates: Candidates) -> None:
        """Find out which corner each saddle shows."""
        found = pair(coarse, self.full, [candidates], self.board, self.pitch_mm, self.others)
        best = found[0]
        self.explained = best.share
        self.full = coarse.full(best.solution.x)
        remark = f"{best.candidates - best.inliers} saddles unmatched; starts: {len(found)}"
        name = f"pairing on {self.glass_frames[0].name}"
        self.note(FitStep(name, best.inliers, float(np.sqrt(0.5)) * best.rms_px, remark))

    def lost(self) -> list[int]:
        """Numbers of the spheres through which the frames do not show what the scene says."""
        x = self.unknowns.free(self.full)
        kept = [self.fits.inliers(self.unknowns, x, frame) for frame in self.behind]
        return lost_spheres(self.unknowns, self.behind, kept)

    def find_all_lost(self, unknowns: Unknowns, coarse: Unknowns, first: Candidates) -> None:
        """Look for every lost sphere, and again for those that are still lost once others have been found.

        A sphere is looked for among the others where they are believed to stand: seen through one that is lost
        itself, or touching it, it is found only after that one.
        """
        frames = [first, *(self.candidates(coarse, frame) for frame in self.glass_frames[1:LOOKED_THROUGH])]
        lost, before = self.lost(), len(self.unknowns.scene.spheres) + 1
        while 0 < len(lost) < before:
            before = len(lost)
            for number in lost:
                if number in self.lost():
                    self.find_lost(unknowns, coarse, frames, number)
            lost = self.lost()

    def find_lost(self, unknowns: Unknowns, coarse: Unknowns, frames: Sequence[Candidates], number: int) -> None:
        """Try a lost sphere in other places until the corners seen through it are where the scene says.

        Where only some of them could be measured they move it, and the others are found from there: a place is
        measured again while that moves it, but not back to where it was believed, which is where no corner does.
        A place that makes the corners of others fit worse, or loses another sphere, is not its place, nor is one
        beside the rim that is seen of it, nor one whose own corners do not fit as well as those: three numbers
        please three wrong corners, but not quite.
        """
        name, before, behind = self.unknowns.scene.spheres[number].name, self.full, self.behind
        scales, before_px, lost = dict(self.fits.scales), self.off_px(number)[1], set(self.lost())
        centre = slice(row := self.unknowns.glass.start + number * len(SPHERE), row + 3)
        believed = self.unknowns.start[centre]
        for place in likely_places(coarse, before, frames, self.board, self.pitch_mm, number):
            self.full = place
            for _ in range(AGAIN):
                stood = self.full[centre]
                self.fit_glass(unknowns, f"{name} elsewhere", only_behind=True)
                still = set(self.lost())
                if number not in still:
                    own_px, others_px = self.off_px(number)
                    alike = own_px <= OWN_WORSE * max(others_px, FLOOR_PX)
                    elsewhere = name in self.rims_elsewhere(legal_scene(self.unknowns, self.full)[0])
                    if still < lost and alike and others_px <= WORSE * before_px and not elsewhere:
                        return
                    break
                stands = self.full[centre]
                if min(np.linalg.norm(stands - stood), np.linalg.norm(stands - believed)) < STAYS_MM:
                    break
            self.fits.scales = dict(scales)
        self.full, self.behind = before, behind

    def off_px(self, number: int) -> tuple[float, float]:
        """Root mean square distance of corners from where they should be [px]: of a sphere, of all others."""
        sphere = self.unknowns.scene.spheres[number]
        behind, x = [_behind(frame) for frame in self.behind], self.unknowns.free(self.full)
        off = np.linalg.norm(self.fits.reprojection(self.unknowns, x, behind), axis=1)
        near = np.concatenate([self.fits.inliers(self.unknowns, x, frame) for frame in behind])
        ways = np.concatenate([frame.branch_name for frame in behind])
        through = np.isin(ways, [way for way in np.unique(ways).tolist() if sphere.is_on(branch_of(way))])
        own, others = (off[near & chosen] for chosen in (through, ~through))
        return (
            float(np.sqrt(np.mean(own**2))) if len(own) else 0.0,
            float(np.sqrt(np.mean(others**2))) if len(others) else 0.0,
        )

    @property
    def pitch_mm(self) -> float:
        """A corrected pixel on the plane."""
        camera = self.unknowns.camera(self.full)
        return camera.position_mm[2] / camera.focal_px

    def check_glass(self, frame: TargetFrame, candidates: Candidates) -> None:
        """Refuse a frame in which the lattice goes on undisturbed where the glass should be."""
        inside, undisturbed = candidates.inside, candidates.inside & candidates.bare
        if np.count_nonzero(inside) < FEWEST:
            raise GlassNotSeen(
                f"{frame.name}: only {np.count_nonzero(inside)} corners where the spheres should be, {FEWEST} are"
                " needed; check light, focus and the spheres of the scene, or use smaller squares"
            )
        if undisturbed.sum() > UNDISTURBED * inside.sum():
            raise GlassNotSeen(
                f"{frame.name}: {int(undisturbed.sum())} of {int(inside.sum())} corners where the spheres should"
                " be lie on the bare lattice; give a frame that shows the target through the glass, or correct the"
                " scene"
            )

    def measure_glass(self, only_behind: bool) -> None:
        """Predict and measure the corners of all frames with glass."""
        scene, _ = legal_scene(self.unknowns, self.full)
        self.behind = [
            glass_frame(
                frame,
                self.board,
                scene,
                self.unknowns.pose(self.full, self.height_number(frame)),
                self.height_number(frame),
                only_behind,
                self.dispersion,
            )
            for frame in self.glass_frames
        ]
        if not any(_behind(frame).index.size for frame in self.behind):
            height_number = self.height_number(self.glass_frames[0])
            width = square_behind_px(scene, self.unknowns.pose(self.full, height_number), self.board)
            if width < LEAST_SQUARE_PX:
                raise GlassNotSeen(
                    f"squares look {width:.1f} px wide through the glass, {LEAST_SQUARE_PX:.0f} are needed;"
                    f" print them {LEAST_SQUARE_PX / max(width, 0.1):.1f} times as large, or take a longer lens"
                )
            raise GlassNotSeen(
                "no corner behind glass could be measured; check focus, light and scene, or print smaller squares"
            )


def _rivals(fit: SceneFit, priors: FitTable, light: Light | None) -> list[Rival]:
    """What the told light may be instead, and how far that is left open."""
    if light is None or priors.light is None:
        return []
    if fit.verdict.many_colours:
        return [(lamp, 1.0) for lamp in any_lamp(fit.scene.wavelength_nm)]
    media = [sphere.medium for sphere in fit.scene.spheres if sphere.medium is not None]
    smear = fit.verdict.smear
    return [
        (rival, max((smear.open_share(medium, light, rival) for medium in media), default=1.0) if smear else 1.0)
        for rival in priors.light.rivals()
    ]


def _pull(solution: Solution) -> float:
    """Largest distance from the priors, in sigmas."""
    return float(np.abs(solution.x).max(initial=0.0))


def _behind(frame: MeasuredFrame) -> MeasuredFrame:
    return frame.taken(frame.behind)


def _refuse_saturated(frames: Sequence[TargetFrame]) -> None:
    for frame in frames:
        share = saturated_fraction(frame.image)
        if share > SATURATED:
            raise FrameError(
                f"{frame.name}: {100.0 * share:.0f} % of the pixels are saturated, which displaces every edge;"
                " expose shorter or close the aperture"
            )
