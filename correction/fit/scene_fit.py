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
from functools import partial

import numpy as np
from numpy.typing import NDArray

from correction.errors import FitFailed, GlassNotSeen
from correction.fit.camera_stage import files_exchanged, find_camera, size_told
from correction.fit.glass_stage import find_glass
from correction.fit.judge.light_of_glass import light_of_glass
from correction.fit.judge.result import FitStep, SceneFit, check
from correction.fit.progress import Progress
from correction.fit.seen.measurement import TargetFrame
from correction.fit.seen.seen_through import balls_seen_otherwise
from correction.fit.seen.smear import Dispersion
from correction.fit.seen.unconfirmed_ways import find_unconfirmed, mask_around
from correction.fit.seen.unlisted_parts import View, compare_views
from correction.fit.seen.unsure_rims import beside_rim, unsure_rims, windows_beside
from correction.fit.solve.light import Rival, any_lamp, back_from_light, in_light, light_uncertainty
from correction.fit.solve.solver import Corners, residuals
from correction.target import Chessboard
from tracer.light import Light
from tracer.scene.fit_section import FitTable
from tracer.scene.scene import Scene


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
        Called with what happens, one line a step.

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
    by_hand = nominal.left_out
    priors, nominal = priors or FitTable(), replace(nominal, masked=())  # judged anew
    light = priors.light.light(nominal.wavelength_nm) if priors.light else None
    work = Progress(in_light(nominal, light), frames, board, priors, say)
    if light is not None and len(light.weight) > 1:
        work.dispersion = Dispersion.of(nominal, light)
    find_camera(work)
    if work.glass_frames:
        try:
            find_glass(work)
        except GlassNotSeen as missing:  # a board of another size is seen elsewhere than the scene shows it
            words = files_exchanged(work), size_told(work), _balls_in_words(work), work.unplaced
            raise GlassNotSeen("; ".join(filter(None, words)) or str(missing)) from None
    fit = _compare_frames_with_model(work, _estimate(work))
    say(str(fit.history[-1]))
    try:
        check(fit)
    except FitFailed as failed:
        raise FitFailed(failed.gate, failed.value, failed.limit, _diagnose_failure(work, failed.reason)) from None
    seen = None
    if light is not None and priors.light is not None:
        seen = light_of_glass(fit, nominal, light, priors.light.is_believed)
    if seen is not None:
        fit = replace(fit, verdict=replace(fit.verdict, wrong_light=str(seen) if seen.alarm else ""))
        light = replace(seen.given, unsure_nm=seen.unsure_nm)
    unsure = light_uncertainty(nominal, light, _rivals(fit, priors, light), priors.wavelength_nm)
    measured = replace(back_from_light(fit.scene, nominal, light), masked=(*by_hand, *fit.verdict.masked))
    return replace(fit, measured_scene=measured, light=unsure)


def _estimate(work: Progress) -> SceneFit:
    """Fit all corners; then again without those whose windows may meet a rim that is not known."""
    measured = [*work.bare, *work.behind]
    fit = work.fits.estimate(work.unknowns, work.full, measured, work.history)
    rims = unsure_rims(fit.scene, fit.ball_root)
    beside_rims = [
        windows_beside(rims, frame) if frame.corners.glass else np.zeros(len(frame), np.bool_)
        for frame in measured
    ]
    if not any(map(np.any, beside_rims)):
        return fit
    kept = [frame.take(~which) for frame, which in zip(measured, beside_rims, strict=True)]
    left = FitStep(
        f"{sum(map(np.count_nonzero, beside_rims))} corners beside rims that are not known are left out"
    )
    return work.fits.estimate(work.unknowns, fit.unknowns.full(fit.x), kept, [*work.history, left])


def _compare_frames_with_model(work: Progress, fit: SceneFit) -> SceneFit:
    """Look in all frames with glass whether they show, and corners confirm, what the fitted scene shows."""
    full = fit.unknowns.full(fit.x)
    views = []
    for frame in work.glass_frames:
        height = work.height_number(frame)
        pose, sigma_mm = fit.unknowns.pose(full, height), partial(_place_sigma_mm, fit, height)
        views.append(View(frame.name, frame.image, pose, sigma_mm))
    sigma = dict(zip(fit.names, fit.sigmas.tolist(), strict=True))
    place = {name[:-2]: size for name, size in sigma.items() if name.endswith(".x")}
    board = work.board.stretch(fit.unknowns.stretch(full))
    radii = np.linalg.norm(fit.ball_root[:, -1], axis=1).tolist()
    sizes = {ball.name: size for ball, size in zip(fit.scene.spheres, radii, strict=True)}
    lattice = [frame.index for frame in work.bare]
    compared = compare_views(fit.scene, views, board, lattice, place, sizes)
    paired = {way: fit.count_paired(way) for way in fit.expected}
    rather = balls_seen_otherwise(fit.scene, views[0].image, views[0].pose, board) if views else {}
    lost = find_unconfirmed(fit.scene, fit.expected, paired, place, work.rims_elsewhere(fit.scene), rather)
    lost_balls = {one.name for one in lost if one.is_ball}
    off = tuple(rim for rim in compared.rims if rim.ball not in lost_balls)
    rims = unsure_rims(fit.scene, fit.ball_root, lost_balls)
    hidden = tuple(patch for patch in fit.verdict.hidden if not beside_rim(rims, patch.middle_px))
    verdict = replace(
        fit.verdict,
        unlisted=tuple(one for one in compared.unlisted if one.rim_of not in {rim.ball for rim in off}),
        unconfirmed=lost,
        hidden=hidden,
        rims=rims,
        misfits=compared.misfits,
        rims_off=tuple((rim, mask_around(rim, fit.scene)) for rim in off),
    )
    return replace(fit, verdict=verdict, board=board)


def _place_sigma_mm(fit: SceneFit, height_number: int, pixels: NDArray[np.float64]) -> NDArray[np.float64]:
    """Standard deviation (N, 2) [mm] of the places on the target at a height that pixels (N, 2) show."""
    numbers = fit.unknowns.full_names
    each = replace(fit.unknowns, names=numbers, columns=np.eye(len(numbers)))
    asked = Corners(height_number, True, pixels, np.zeros_like(pixels), 1.0)
    by_number = residuals(each, fit.unknowns.columns @ fit.x, asked).rate
    return np.asarray(np.sqrt(((by_number @ fit.root) ** 2).sum(axis=2)))


def _diagnose_failure(work: Progress, reason: str) -> str:
    """Say how large the bare board is seen, and what rims and views of the balls show, then why the fit failed."""
    seen = work.outlines.in_words(0.0) if work.outlines else ""
    return "; ".join(
        each for each in (size_told(work), _balls_in_words(work), work.unplaced, seen, reason) if each
    )


def _balls_in_words(work: Progress) -> str:
    """Say what balls as given are not as the first frame with glass shows them."""
    if not work.glass_frames:
        return ""
    frame = work.glass_frames[0]
    scene = work.unknowns.scene.with_camera(work.unknowns.camera(work.full))
    pose = work.unknowns.pose(work.full, work.height_number(frame))
    return "; ".join(balls_seen_otherwise(scene, frame.image, pose, work.print_found, is_refused=True).values())


def _rivals(fit: SceneFit, priors: FitTable, light: Light | None) -> list[Rival]:
    """List the lights that fit.light may stand for instead, and the share of the difference that is left open."""
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
