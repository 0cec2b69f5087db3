"""The glass, from the frames that show the target through it, while the camera is held.

Balls are put where their rims are seen, saddles paired with lattice corners from several starts (`pairing`), then
corners on every sheet predicted, measured to sub-pixel and fitted, twice; balls whose corners are not where the
scene shows them are looked for in between (`lost_sphere`).
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from correction.errors import GlassNotSeen
from correction.fit.adjustment import CAUCHY_SIGMAS, OUTLIER, feasible_scene
from correction.fit.judge.result import FitStep
from correction.fit.progress import Progress
from correction.fit.seen.edges_of_blocks import find_edges
from correction.fit.seen.lost_sphere import find_lost_spheres, likely_places
from correction.fit.seen.measurement import (
    FLOOR_PX,
    TargetFrame,
    glass_frame,
)
from correction.fit.seen.packing_place import PACKING_FOUND, PACKING_REACH, find_packing
from correction.fit.seen.pairing import Candidates, candidates_of, pair
from correction.fit.seen.prediction import MIN_VIEW_SQUARE_PX, expect, square_behind_px
from correction.fit.seen.silhouettes import find_outlines, follow_outlines
from correction.fit.solve.block_edges import edge_rates
from correction.fit.solve.solver import minimise
from correction.fit.solve.unknowns import Unknowns
from correction.target.turned_frame import turn_between
from tracer.bodies import Block
from tracer.scene.scene import Scene
from tracer.strategies.branches import branch_of
from tracer.strategies.sensitivity import SPHERE

MIN_SADDLE_RATIO = 0.01  # saddles behind glass are this strong, compared to the bare target, or noise
MIN_GLASS_CORNERS = 12  # corners behind glass from which a fit may begin
# A ball whose rim is seen farther than this from its place, or than FOLLOW sigmas, is followed
ASIDE_MM = 1.0
FOLLOW = 1.0
STRAY_DEPTH_SIGMA_MM = 3.0  # what is known of the depth of a ball that does not stand where it was said to
MIN_PAIRED_SHARE = 0.3  # share of saddles on corners up to which a single lost ball is not what is wrong
LOOKED_THROUGH = 3  # frames in which a lost ball is looked for: few corners of it may be in each
# Times that a place is measured, while corners move the ball that stands there
AGAIN = 6
STAYS_MM = 0.02
# Times, that corners of others may fit worse than before, and its own than others
WORSE = 1.2
OWN_WORSE = 3.0
# Of the balls: unless fewer are lost once corners are measured, which tells more than saddles do
FEW_LOST = 0.5
# How far edges of blocks are looked for, at first and again
SEARCH_PX = 80.0
REFINE_PX = 4.0
UNDISTURBED = 0.9  # share of bare-lattice corners inside the glass's outline from which there is no glass


def find_glass(work: Progress) -> None:
    """Fit the glass to the corners seen through it, the camera held."""
    _refuse_turned(work)
    if not _move_packing(work):
        _follow_outlines(work)
    prefixes = [f"{sphere.name}." for sphere in work.unknowns.scene.spheres] + ["glass "]
    prefixes += [f"{body.name}." for body, _ in work.unknowns.other_bodies.bodies if not body.stays]
    _find_edges(work, SEARCH_PX)
    unknowns = work.unknowns.around(work.full).only(prefixes)
    places = [f"{body.name}.{part}" for body in unknowns.scene.spheres for part in "xyz"]
    places += [
        f"{body.name}.{number.name}"
        for body, numbers in work.unknowns.other_bodies.bodies
        if isinstance(body, Block) and not body.stays
        for number in numbers
        if number.known in ("place_mm", "tilt_deg")
    ]
    coarse = unknowns.only([*places, "glass "])
    candidates = _candidates(work, coarse, work.glass_frames[0])
    _refuse_undisturbed(work, work.glass_frames[0], candidates)
    _pair(work, coarse, candidates)
    _fit_glass(work, unknowns, "pass 1", only_behind=True)
    lost = _spheres_lost(work)
    if lost and (work.explained > MIN_PAIRED_SHARE or len(lost) < FEW_LOST * len(unknowns.scene.spheres)):
        _find_all_lost(work, unknowns, coarse, candidates)
    _find_edges(work, REFINE_PX)
    _fit_glass(work, replace(unknowns, edges=work.unknowns.edges), "pass 2", only_behind=False)


def _find_edges(work: Progress, most_px: float) -> None:
    """Put blocks where the frames show their edges, and keep these for the fits that follow."""
    bare = {(frame.pose, frame.height_mm): frame for frame in reversed(work.bare_frames)}
    pairs = [
        (frame, bare[frame.pose, frame.height_mm])
        for frame in work.glass_frames
        if (frame.pose, frame.height_mm) in bare
    ]
    edges = find_edges(work.unknowns, work.full, pairs, most_px)
    while edges:
        names = sorted({edge.block for edge in edges})
        unknowns = replace(work.unknowns, edges=edges)
        own = unknowns.around(work.full).only([f"{name}." for name in names])
        x = minimise(own, lambda _: [], own.free(work.full), knee=CAUCHY_SIGMAS).x
        off = np.abs(edge_rates(own, x)[0])
        if off.max() < OUTLIER:
            work.full, work.unknowns = own.full(x), unknowns
            work.note(FitStep(f"edges of {', '.join(names)}: {len(edges)} points of the outline"))
            return
        edges = tuple(np.delete(np.array(edges, dtype=object), int(np.argmax(off))))  # the edge of something else


def _refuse_turned(work: Progress) -> None:
    """Refuse frames with glass that are turned or mirrored, where those of the bare target are not."""
    bare = {(frame.pose, frame.height_mm): frame for frame in reversed(work.bare_frames)}
    for frame in work.glass_frames:
        own = bare.get((frame.pose, frame.height_mm))
        words = turn_between(own.image, frame.image) if own else ""
        if own and words:
            raise GlassNotSeen(
                f"{frame.name} {words} against {own.name}: turn the file back, or take the frame again with the"
                " camera set as for the bare target"
            )


def _follow_outlines(work: Progress) -> None:
    """Put balls whose rims are seen elsewhere where they are seen, and take that for what is known of them."""
    frame = work.glass_frames[0]
    least = MIN_SADDLE_RATIO * float(np.median(work.saddles(work.bare_frames[0]).strength))
    number = work.height_number(frame)
    saddles = work.saddles(frame)
    board = work.print_found
    work.outlines = find_outlines(work.unknowns, work.full, work.bare[0], saddles, least, number, board)
    if work.outlines is None:
        return
    known = [work.priors.sphere(name).centre_mm for name in work.outlines.names]
    off = work.outlines.surely_off(ASIDE_MM) & (work.outlines.sideways_mm > FOLLOW * np.array(known))
    if off.any():
        work.others = [follow_outlines(work.unknowns, work.full, work.outlines, alone=True), work.full]
        work.full = follow_outlines(work.unknowns, work.full, work.outlines)
        start = work.unknowns.start.copy()
        start[work.unknowns.glass] = work.full[work.unknowns.glass]
        depths = [f"{name}.z" for name in work.outlines.names]
        work.unknowns = work.unknowns.around(start).loosen(depths, STRAY_DEPTH_SIGMA_MM)
        work.note(FitStep(f"{work.outlines.in_words(ASIDE_MM)}; glass follows"))


def _move_packing(work: Progress) -> bool:
    """Put a packing where the first frame shows it as a whole; return whether it was found."""
    unknowns = work.unknowns.around(work.full)
    if not unknowns.packing:
        return False
    known_mm = work.priors.spheres.centre_mm
    candidates = _candidates(work, unknowns, work.glass_frames[0])
    found, work.explained = find_packing(unknowns, candidates, work.board, work.pitch_mm, known_mm)
    if work.explained < PACKING_FOUND:
        work.unplaced = (
            f"the packing was not found within {PACKING_REACH * known_mm:g} mm of its place in the scene file:"
            " correct that, or give a larger centre_mm under spheres of the fit section"
        )
        return False
    move = (found - work.full)[work.unknowns.glass].reshape(-1, len(SPHERE))[:, :3]
    work.full = found
    if np.linalg.norm(move, axis=1).max() > known_mm:
        start = work.unknowns.start.copy()
        for part in (work.unknowns.glass, work.unknowns.others):
            start[part] = found[part]
        work.unknowns = work.unknowns.around(start)
        x, y, z = move.mean(axis=0).tolist()
        work.note(
            FitStep(f"the packing stands x {x:+.1f}, y {y:+.1f}, z {z:+.1f} mm from its place; glass follows")
        )
    return True


def _candidates(work: Progress, coarse: Unknowns, frame: TargetFrame) -> Candidates:
    """Saddles of a frame that may be seen through glass."""
    least = MIN_SADDLE_RATIO * float(np.median(work.saddles(work.bare_frames[0]).strength))
    number, board = work.height_number(frame), work.print_found
    return candidates_of(work.corner_saddles(frame), least, coarse, work.full, number, board)


def _refuse_undisturbed(work: Progress, frame: TargetFrame, candidates: Candidates) -> None:
    """Refuse a frame in which the lattice goes on undisturbed where the glass should be."""
    inside, undisturbed = candidates.inside, candidates.inside & candidates.bare
    if np.count_nonzero(inside) < MIN_GLASS_CORNERS:
        raise GlassNotSeen(
            f"{frame.name}: only {np.count_nonzero(inside)} corners where the glass should be,"
            f" {MIN_GLASS_CORNERS} are needed; check light, focus and the glass of the scene, or use smaller"
            " squares"
        )
    if undisturbed.sum() > UNDISTURBED * inside.sum():
        raise GlassNotSeen(
            f"{frame.name}: {int(undisturbed.sum())} of {int(inside.sum())} corners where the glass should"
            " be lie on the bare lattice; give a frame that shows the target through the glass, or correct the"
            " scene"
        )


def _pair(work: Progress, coarse: Unknowns, candidates: Candidates) -> None:
    """Find out which corner each saddle shows."""
    found = pair(coarse, work.full, [candidates], work.board, work.pitch_mm, work.others)
    best = found[0]
    work.explained = best.share
    work.full = coarse.full(best.solution.x)
    name = f"which corner is which on {work.glass_frames[0].name}"
    work.note(FitStep(name, best.inliers, float(np.sqrt(0.5)) * best.rms_px))


def _fit_glass(work: Progress, unknowns: Unknowns, name: str, only_behind: bool) -> None:
    """Measure the corners where the scene shows them, and fit the glass to them."""
    _measure(work, only_behind)
    behind = [frame.take(frame.behind) for frame in work.behind]
    solution = work.fits.solve(unknowns, unknowns.free(work.full), behind)
    work.full = unknowns.full(solution.x)
    work.note(work.fits.step(f"glass, {name}", unknowns, solution.x, behind))


def _measure(work: Progress, only_behind: bool) -> None:
    """Predict and measure the corners of all frames with glass."""
    scene, _ = feasible_scene(work.unknowns, work.full)
    work.behind = [
        glass_frame(
            frame,
            work.board,
            scene,
            work.unknowns.pose(work.full, work.height_number(frame)),
            work.height_number(frame),
            only_behind,
            work.dispersion,
        )
        for frame in work.glass_frames
    ]
    if not any(frame.behind.any() for frame in work.behind):
        raise GlassNotSeen(_why_none(work, scene))


def _why_none(work: Progress, scene: Scene) -> str:
    """Explain that no corner behind glass could be measured, as far as the scene shows, nominal and present."""
    pose = work.unknowns.pose(work.full, work.height_number(work.glass_frames[0]))
    given, _ = feasible_scene(work.unknowns, work.unknowns.start)
    widths = [square_behind_px(one, pose, work.print_found) for one in (given, scene)]
    if 0.0 < widths[0] < MIN_VIEW_SQUARE_PX:
        return (
            f"squares look {widths[0]:.1f} px wide through the glass, {MIN_VIEW_SQUARE_PX:.0f} are needed;"
            f" print them {MIN_VIEW_SQUARE_PX / max(widths[0], 0.1):.1f} times as large, or take a longer lens"
        )
    if widths[1] < MIN_VIEW_SQUARE_PX:  # the search has gone astray: of the scene as given that says nothing
        return (
            "no corner is seen where the scene shows one behind glass: check radius, glass and place of each ball,"
            " whether a ball is hollow (give its core) or not listed, and the focus of the frame"
        )
    if not expect(given, pose, work.print_found).branch.any():
        return (
            "the scene shows no corner of the board whole behind glass, with the squares around it; print smaller"
            " squares, or check the scene"
        )
    return "no corner behind glass could be measured; check focus, light and scene, or print smaller squares"


def _spheres_lost(work: Progress) -> list[int]:
    """Numbers of the spheres through which the frames do not show what the scene says."""
    x = work.unknowns.free(work.full)
    kept = [work.fits.inliers(work.unknowns, x, frame) for frame in work.behind]
    return find_lost_spheres(work.unknowns, work.behind, kept)


def _find_all_lost(work: Progress, unknowns: Unknowns, coarse: Unknowns, first: Candidates) -> None:
    """Look for every lost sphere, and again for those that are still lost once others have been found.

    A sphere is looked for among the others where they are believed to stand: seen through one that is lost
    itself, or touching it, it is found only after that one.  One that is known to touch its neighbours is not
    looked for: they hold it.
    """
    held = {ball for pair in work.unknowns.packing.values() for ball in pair}
    frames = [first, *(_candidates(work, coarse, frame) for frame in work.glass_frames[1:LOOKED_THROUGH])]
    lost, before = set(_spheres_lost(work)) - held, len(work.unknowns.scene.spheres) + 1
    while 0 < len(lost) < before:
        before = len(lost)
        for number in sorted(lost):
            if number in _spheres_lost(work):
                _find_lost(work, unknowns, coarse, frames, number)
        lost = set(_spheres_lost(work)) - held


def _find_lost(
    work: Progress, unknowns: Unknowns, coarse: Unknowns, frames: Sequence[Candidates], number: int
) -> None:
    """Try a lost sphere in other places until the corners seen through it are where the scene says.

    Where only some of them could be measured they move it, and the others are found from there: a place is
    measured again while that moves it, but not back to where it was believed, which is where no corner does.
    A place that makes the corners of others fit worse, or loses another sphere, is not its place, nor is one
    beside the rim that is seen of it, nor one whose own corners do not fit as well as those: three numbers
    please three wrong corners, but not quite.
    """
    name, before, behind = work.unknowns.scene.spheres[number].name, work.full, work.behind
    scales, before_px, lost = dict(work.fits.scales), _off_px(work, number)[1], set(_spheres_lost(work))
    centre = slice(row := work.unknowns.glass.start + number * len(SPHERE), row + 3)
    believed = work.unknowns.start[centre]
    for place in likely_places(coarse, before, frames, work.board, work.pitch_mm, number):
        work.full = place
        for _ in range(AGAIN):
            stood = work.full[centre]
            _fit_glass(work, unknowns, f"{name} elsewhere", only_behind=True)
            still = set(_spheres_lost(work))
            if number not in still:
                own_px, others_px = _off_px(work, number)
                alike = own_px <= OWN_WORSE * max(others_px, FLOOR_PX)
                elsewhere = name in work.rims_elsewhere(feasible_scene(work.unknowns, work.full)[0])
                if still < lost and alike and others_px <= WORSE * before_px and not elsewhere:
                    return
                break
            stands = work.full[centre]
            if min(np.linalg.norm(stands - stood), np.linalg.norm(stands - believed)) < STAYS_MM:
                break
        work.fits.scales = dict(scales)
    work.full, work.behind = before, behind


def _off_px(work: Progress, number: int) -> tuple[float, float]:
    """Root mean square distance of corners from where they should be [px]: of a sphere, of all others."""
    sphere = work.unknowns.scene.spheres[number]
    behind, x = [frame.take(frame.behind) for frame in work.behind], work.unknowns.free(work.full)
    off = np.linalg.norm(work.fits.reprojection(work.unknowns, x, behind), axis=1)
    near = np.concatenate([work.fits.inliers(work.unknowns, x, frame) for frame in behind])
    ways = np.concatenate([frame.branch_name for frame in behind])
    through = np.isin(ways, [way for way in np.unique(ways).tolist() if sphere.is_on(branch_of(way))])
    own, others = (off[near & chosen] for chosen in (through, ~through))
    return (
        float(np.sqrt(np.mean(own**2))) if len(own) else 0.0,
        float(np.sqrt(np.mean(others**2))) if len(others) else 0.0,
    )
