"""The camera, from the bare target.

It is fitted to all heights; the target at z = 0 defines the world.  With walls that stand there, corners are then
measured where the scene shows them, twice; middles of dots are taken back to their centres.

A board may hang turned or leaning before a bench that is as described.  The board at z = 0 is the world
(docs/adr/0005), so a board put in 17 degrees askew looks like a camera that rolled, and one that leans like a
camera that moved sideways and turned back.  Such a move is larger than any camera's and has a mark: camera and
position turn together about the board.  With b the turn of the bench as seen from the board, B its matrix, p0, R0
the nominal camera and p, R the one that the bare board shows,

    min over b   |p - B p0|^2 / sigma_p^2 + |log(R B R0^T)|^2 / sigma_r^2 + |b|^2 / LARGE^2.

The whole bench is turned by it, glass and travel of the stage included: they stand as described, the board
does not.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy
from numpy.typing import NDArray

from correction.errors import FitFailed, TargetNotFound
from correction.fit.adjustment import Adjustment, feasible_scene
from correction.fit.judge.hypothesis_words import NAMED_TERM_SIGMAS, target_heights
from correction.fit.judge.result import SHARE_LIMIT, FitStep, rms_limit_px
from correction.fit.judge.verdict import PRIOR_LIMIT
from correction.fit.levels_shown import levels_shown, look_like_levels
from correction.fit.pose_stage import drop_other_boards, find_poses
from correction.fit.progress import Progress
from correction.fit.seen.measurement import (
    FLOOR_PX,
    SHADOWED,
    MeasuredFrame,
    TargetFrame,
    bare_frame,
    bare_frame_through_walls,
    centre_dots,
)
from correction.fit.seen.prediction import expect
from correction.fit.solve.contact import clear_of, push_apart
from correction.fit.solve.solver import Solution
from correction.fit.solve.unknowns import ASIDE, WIDER, Unknowns, lens_reach, unknowns_of
from correction.target.board_search import Predict, corners_in_view
from correction.target.lattice_growth import LEAST_BOARD
from correction.target.size_seen import size_seen
from correction.target.two_levels import dot_spread_mm
from tracer.bodies import vector3
from tracer.camera import Camera, Vector3
from tracer.scene.fit_section import FitCameraTable
from tracer.scene.scene import Scene

LENS_FREED = {"principal_px": 100.0, "k1": 1.0, "k2": 5.0, "p1": 0.01, "p2": 0.01}  # sigmas that hold short lenses
DISTORTED = 0.1  # of a corner's distance from the axis, by a term: those of long lenses are large numbers
HEIGHTS_FREED = 0.05  # share by which all heights of the target may be off
FAR_OR_LARGE = ("camera.z", "camera.focal_px", "print.st")  # numbers that are seen as one: how large the board is
MORE = 1.05  # times as many corners that the bare target shows without glass
ON_BARE = ("camera.", "target", "print.")  # numbers that the bare target tells of
CAMERA_SIGMAS = 3.0  # sigmas that the camera may be off
THROUGH_WALLS = 2  # times that corners of the bare target are measured again behind walls
COARSER = 4  # times that a view through walls is predicted coarser than frames
LARGE_DEG = 30.0  # what a turn of the board is believed to be
GRAIN_PX, STEEPEST = 1.0, 0.998  # smoothing against noise; quantile of slopes that is an edge's steepest
SHADOWS = (
    "dots of the lower level of the plate are seen aside of their places, as if shadows or walls of grooves cut"
    " them; light it along the grooves or from both sides, and turn it until no wall hides a dot from the camera"
)
BLURRED_PX, BLURRED = 2.0, 0.12  # pixels, and share of a square, from which an edge hides marks of 0.4 squares


def find_camera(work: Progress) -> None:
    """Fit the camera to the bare target, or say why none fits."""
    try:
        unknowns, solution = _fit_camera(work, work.bare_frames[:1], _reach(work))
    except TargetNotFound as missing:
        raise TargetNotFound(files_exchanged(work) or _out_of_focus(work) or str(missing)) from None
    if solution.pull > PRIOR_LIMIT and not cause_on_bare(work):
        unknowns, solution = _follow_board(work, unknowns, solution)
    if on_stage := [frame for frame in work.bare_frames[1:] if not frame.pose]:
        unknowns, solution = _fit_camera(work, on_stage)
    if work.poses:
        # One board hardly tells how thick a tank is: all boards together start from walls as described.
        work.full, walls = work.full.copy(), work.unknowns.others
        work.full[walls] = work.unknowns.start[walls]
        find_poses(work)
        unknowns = work.unknowns.only((*ON_BARE, *work.walls))
        solution = _fit_bare(work, unknowns, "camera and poses by hand", 0)
        if drop_other_boards(work):
            unknowns = work.unknowns.only((*ON_BARE, *work.walls))
            solution = _fit_bare(work, unknowns, "camera and poses by hand, again", 0)
    for _ in range(THROUGH_WALLS if work.walls else 0):
        solution = _measure_through_walls(work, unknowns)
    if work.board.dots is not None:
        solution = _centre_dots(work, unknowns)
    _check(work, _bare_rms_px(work, unknowns, solution.x), unknowns, solution)
    for name, pull in zip(unknowns.names, solution.x.tolist(), strict=True):
        if name.startswith(FAR_OR_LARGE) and abs(pull) > CAMERA_SIGMAS:
            work.note(
                FitStep(
                    f"warning: {name} is {abs(pull):.1f} sigmas from what was known of it before; measure the"
                    " distance of the camera and the print again: an error of either is one of every length"
                )
            )


def _out_of_focus(work: Progress) -> str:
    """Say that edges of the first bare frame are too blurred for its marks.

    An edge of contrast A, blurred by a Gaussian of sigma s, has a slope of A / (s sqrt(2 pi)) at most.
    """
    frame = work.bare_frames[0]
    light = scipy.ndimage.gaussian_filter(frame.image.astype(np.float64), GRAIN_PX)
    contrast = float(np.ptp(np.quantile(light, (0.05, 0.95))))
    steepest = float(np.quantile(np.hypot(*np.gradient(light)), STEEPEST))
    blur_px, square_px = (
        contrast / max(steepest * np.sqrt(2.0 * np.pi), 1e-9),
        work.board.square_mm / work.pitch_mm,
    )
    if not max(BLURRED_PX, BLURRED * square_px) < blur_px < square_px:
        return ""
    return (
        f"{frame.name}: its edges are blurred by {blur_px:.1f} px (one sigma), and squares are {square_px:.0f} px"
        " wide: the frame is out of focus, so that the marks of the board cannot be identified; focus the lens on"
        " the board, or close its aperture"
    )


def files_exchanged(work: Progress) -> str:
    """Say that a frame named as one with glass shows the bare target, where the bare one shows less of it."""
    own, reach = work.bare_frames[0], _reach(work)
    found = [len(frame) for frame in work.bare[:1]]
    for frame in work.glass_frames:
        if frame.pose or frame.height_mm != own.height_mm:
            continue
        try:
            other, _ = bare_frame(frame, work.board, _predict_view(work, frame, work.unknowns.start), 0, reach)
        except TargetNotFound:
            continue
        if not other.refused.get("FOREIGN") and len(other) > MORE * sum(found):
            return (
                f"{frame.name} shows the bare target without glass, and {own.name} does not: the files are"
                " exchanged; rename them"
            )
    return ""


def _heights_exchanged(work: Progress) -> str:
    """Say that the bare target fits with heights of the other sign, where it does not with those given."""
    heights = work.unknowns.heights_mm
    bare = [frame for frame in work.bare if frame.corners.height_number < len(heights)]
    if len(bare) < 2 or not any(heights):
        return ""
    known = work.board.print_sigma
    other = unknowns_of(work.nominal, [-z for z in work.heights], work.priors, work.focal_free, print_sigma=known)
    other = other.only((*ON_BARE, *work.walls))
    frames = [_at_height(frame, other, -heights[frame.corners.height_number]) for frame in bare]
    fit = Adjustment().solve(other, other.free(other.start), frames)
    rms_px = float(np.sqrt(np.mean(Adjustment().reprojection(other, fit.x, frames) ** 2)))
    if not (fit.pull <= PRIOR_LIMIT and rms_px <= _limit_px(work)):
        return ""
    return (
        "the bare target is seen where it should be with its heights exchanged: z+ and z- are swapped in the file"
        " names, or the axis of the target runs the other way (z is positive towards the camera)"
    )


def _at_height(frame: MeasuredFrame, unknowns: Unknowns, height_mm: float) -> MeasuredFrame:
    """Return a frame as one of the target at another height."""
    number = int(np.argmin(np.abs(np.array(unknowns.heights_mm) - height_mm)))
    return replace(frame, corners=replace(frame.corners, height_number=number))


def _reach(work: Progress) -> float:
    """Squares by which the nominal camera's view of the board may be off."""
    known, away = work.priors.camera, np.linalg.norm(work.nominal.camera.position_mm)
    off_mm = np.hypot(known.position_mm, np.deg2rad(known.rotation_deg) * away)
    return float(CAMERA_SIGMAS * off_mm / work.board.square_mm)


def _fit_camera(
    work: Progress, frames: Sequence[TargetFrame], reach: float | None = None
) -> tuple[Unknowns, Solution]:
    """Find the bare target in more frames, one by one, and fit the camera to all there are."""
    for frame in frames:
        number = work.height_number(frame)
        found, work.board = bare_frame(frame, work.board, _predict_view(work, frame, work.full), number, reach)
        work.bare.append(found)
        _allow_shadows(work, found)
        unknowns = work.unknowns.only((*ON_BARE, *work.walls))
        if found.origin_basis and reach is not None and work.board.dots is not None:
            basis = (
                f"rests on {found.origin_basis}, as no mark is in view: an error of whole pitches would not show"
            )
            work.note(FitStep(f"the origin of the target {basis}"))
        solution = _fit_bare(work, unknowns, f"camera on {frame.name}", -1)
    return unknowns, solution


def _allow_shadows(work: Progress, frame: MeasuredFrame) -> None:
    """Let all dots of the lower level of a plate be aside by as much as shadows make each of them uncertain.

    Walls of grooves hide more of the dots on one side of the view than on the other.  Where that makes dots of the
    lower level much less certain than those of the face, the whole level may be larger as well, which looks like
    another step.
    """
    deep = work.unknowns.is_deep(frame.corners.depth_mm)
    if not frame.corners.depth_mm.any() or not deep.any() or deep.all():
        return
    spread_mm = dot_spread_mm(frame.sigma_px, frame.axes_px, work.board.square_mm)
    shadow_mm, face_mm = float(np.median(spread_mm[deep])), float(np.median(spread_mm[~deep]))
    work.shadow_mm = max(work.shadow_mm, shadow_mm)
    if shadow_mm > SHADOWED * face_mm:
        reach_mm = float(np.linalg.norm(frame.corners.node_mm[deep].std(axis=0)))
        work.shadow_share = max(work.shadow_share, shadow_mm / reach_mm)
    work.unknowns = work.unknowns.loosen(ASIDE, work.shadow_mm).loosen([WIDER], work.shadow_share)


def _predict_view(work: Progress, frame: TargetFrame, full: NDArray[np.float64]) -> Predict:
    """Return where a scene shows points of the board in a bare frame, through walls that stand there."""
    camera, number = work.unknowns.camera(full), work.height_number(frame)

    def by_camera(place_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        return camera.project(place_mm + np.array((0.0, 0.0, frame.height_mm)))

    if not work.walls:
        return by_camera
    scene = feasible_scene(work.unknowns, full)[0].bare()
    view = expect(scene, work.unknowns.pose(full, number), work.board, COARSER)
    if not len(view):
        return by_camera
    places = {(i, j): pixel for (i, j), pixel in zip(view.index.tolist(), view.pixel, strict=True)}

    def through_walls(place_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        index = work.board.nearest_index(place_mm[:, :2]).tolist()
        return np.array([places.get((i, j), (np.nan, np.nan)) for i, j in index]).reshape(-1, 2)

    return through_walls


def _measure_through_walls(work: Progress, unknowns: Unknowns) -> Solution:
    """Measure the bare target where camera and walls show it, and fit these again."""
    scene = feasible_scene(work.unknowns, work.full)[0].bare()
    work.bare = [
        bare_frame_through_walls(
            frame,
            work.board,
            scene,
            work.unknowns.pose(work.full, number := work.height_number(frame)),
            number,
        )
        for frame in work.bare_frames
    ]
    _refuse_few_marks(work, "clear of the edges of the walls")
    return _fit_bare(work, unknowns, "camera through walls", 0)


def _centre_dots(work: Progress, unknowns: Unknowns) -> Solution:
    """Take the middles of pictures of dots back to their centres, as the scene shows them, and fit again."""
    scene = feasible_scene(work.unknowns, work.full)[0].bare()
    work.bare = [
        centre_dots(one, work.board, scene, work.unknowns.pose(work.full, one.corners.height_number))
        for one in work.bare
    ]
    _refuse_few_marks(work, "seen whole and large enough")
    return _fit_bare(work, unknowns, "camera by centres of dots", 0)


def _fit_bare(work: Progress, unknowns: Unknowns, what: str, first: int) -> Solution:
    """Fit the corners of all bare frames, and note the residuals of those from a first one on."""
    solution = work.fits.solve(unknowns, unknowns.free(work.full), work.bare)
    work.full = unknowns.full(solution.x)
    work.note(work.fits.step(what, unknowns, solution.x, work.bare[first:]))
    return solution


def _refuse_few_marks(work: Progress, how: str) -> None:
    """Refuse frames of the bare target of which too few marks are left to fit a camera to."""
    marks = "corners" if work.board.dots is None else "dots"
    for frame in work.bare:
        if len(frame) < LEAST_BOARD:
            raise TargetNotFound(
                f"{frame.name}: only {len(frame)} {marks} of the bare target are {how}, {LEAST_BOARD} are needed;"
                " show more of the target, nearer or sharper"
            )


def _follow_board(work: Progress, unknowns: Unknowns, solution: Solution) -> tuple[Unknowns, Solution]:
    """Turn the nominal bench as the board shows it turned, if that explains the camera."""
    turn = turn_of_bench(work.nominal.camera, unknowns.camera(work.full), work.priors.camera)
    travel = (float(turn[0, 2]), float(turn[1, 2]), float(turn[2, 2]))
    followed = work.unknowns_of(turn_scene(work.nominal, turn), work.priors, travel)
    other = followed.only((*ON_BARE, *work.walls))
    again = work.fits.solve(other, np.zeros(len(other.names)), work.bare)
    if again.pull > PRIOR_LIMIT:
        return unknowns, solution
    work.unknowns, work.full = followed, other.full(again.x)
    work.note(FitStep(in_words(turn)))
    return other, again


def cause_on_bare(work: Progress) -> str:
    """Say which of lens and heights, once it is free, explains the bare target with a camera as described.

    Numbers that are free explain a little of anything: by Schwarz's criterion they must be worth their number.
    """
    given = work.unknowns.only((*ON_BARE, *work.walls))
    before = Adjustment().solve(given, given.free(given.start), work.bare)
    alone, numbers = _bare_rms_px(work, given, before.x), 2 * sum(map(len, work.bare))
    found = []
    for wider, say in ((_lens_freed(work), _lens_in_words), (_heights_freed(given), _heights_in_words)):
        if wider is None:
            continue
        after = Adjustment().solve(wider, wider.free(wider.start), work.bare)
        rms = _bare_rms_px(work, wider, after.x)
        gain = 2.0 * numbers * np.log(alone / rms) + float(before.x @ before.x - after.x @ after.x)
        gain -= (len(wider.names) - len(given.names)) * np.log(numbers)
        if after.pull <= PRIOR_LIMIT and rms <= _limit_px(work) and gain >= 0.0:  # none of them NaN
            found.append((gain, say(given, wider, after, rms)))
    return max(found)[1] if found else ""


def _lens_freed(work: Progress) -> Unknowns:
    """Return the unknowns of the bare target with every term of the lens free."""
    far = lens_reach(work.nominal.camera)
    sizes = {name: max(size, DISTORTED * far.get(name, 0.0)) for name, size in LENS_FREED.items()}
    free = {name: max(size, getattr(work.priors.camera, name)) for name, size in sizes.items()}
    camera = work.priors.camera.model_copy(update=free)
    wider = work.unknowns_of(work.nominal, work.priors.model_copy(update={"camera": camera}))
    return wider.only((*ON_BARE, *work.walls))


def _heights_freed(given: Unknowns) -> Unknowns | None:
    """The same if all heights of the target may be off by one factor; None if there is only one height."""
    heights = np.zeros_like(given.start)
    heights[given.on_stage] = HEIGHTS_FREED * given.start[given.on_stage]
    if not heights.any():
        return None
    return replace(given, names=(*given.names, "heights"), columns=np.column_stack((given.columns, heights)))


def _lens_in_words(given: Unknowns, wider: Unknowns, after: Solution, rms_px: float) -> str:
    new = [name for name in wider.names if name not in given.names]
    values = dict(zip(wider.names, after.x * wider.sigma, strict=True))
    spread = np.sqrt(np.diag(np.linalg.inv(after.normal + np.eye(len(after.x)))))
    sigma = dict(zip(wider.names, wider.sigma * spread, strict=True))
    found = [f"{name} {values[name]:+.2g}" for name in new if abs(values[name]) > NAMED_TERM_SIGMAS * sigma[name]]
    if not found:
        return ""
    free = dict(zip(wider.names, wider.sigma.tolist(), strict=True))
    sizes = {name: free["camera.cu" if name == "principal_px" else f"camera.{name}"] for name in LENS_FREED}
    return (
        f"the lens is off its axis or distorts more than described: with its terms free the bare target is where"
        f" the camera shows it, to {rms_px:.2g} px, and {', '.join(found)} differ from what was held; free them in"
        f" fit.camera: {', '.join(f'{name}: {size:.2g}' for name, size in sizes.items())}"
    )


def _heights_in_words(given: Unknowns, wider: Unknowns, after: Solution, rms_px: float) -> str:
    spread = np.sqrt(np.diag(np.linalg.inv(after.normal + np.eye(len(after.x)))))
    return target_heights(HEIGHTS_FREED * after.x[-1:], HEIGHTS_FREED * spread[-1:])


def _bare_rms_px(work: Progress, unknowns: Unknowns, x: NDArray[np.float64]) -> float:
    """Residual of the bare target's corners; through walls of those that these show well, if most are."""
    off = work.fits.reprojection(unknowns, x, work.bare)
    kept = np.concatenate([work.fits.inliers(unknowns, x, frame) for frame in work.bare])
    if work.walls and kept.mean() >= SHARE_LIMIT:  # at the edge of a tube the view is squeezed, or lost
        off = off[kept]
    return float(np.sqrt(np.mean(off**2)))


def _limit_px(work: Progress) -> float:
    """Largest residual of the bare target that is taken as a fit."""
    sigma = [np.hypot(frame.sigma_px, FLOOR_PX).ravel() for frame in work.bare]
    return rms_limit_px(float(np.nanmedian(np.concatenate(sigma))))


def _check(work: Progress, rms_px: float, unknowns: Unknowns, solution: Solution) -> None:
    """Refuse a camera that does not fit the bare target."""
    limit, pull = _limit_px(work), solution.pull
    fits = rms_px <= limit and pull <= PRIOR_LIMIT
    other = not fits or look_like_levels(work, unknowns, solution.x)
    lens = levels_shown(work, limit) if other else ""
    if fits and lens:
        raise FitFailed("levels of dots", rms_px, limit, lens)
    lens = lens or ("" if fits else cause_on_bare(work))
    if not rms_px <= limit:
        raise FitFailed(
            "bare target",
            rms_px,
            limit,
            lens
            or _heights_exchanged(work)
            or size_told(work)
            or (SHADOWS if work.shadow_mm > work.board.step_sigma_mm else "")
            or "the corners of the bare target do not fit any camera near the nominal one; check square_mm,"
            " free more lens terms in the fit section, or check that the board is flat",
        )
    if pull > PRIOR_LIMIT:
        name = unknowns.names[int(np.argmax(np.abs(solution.x)))]
        wall = name.rpartition(".")[0] if name.startswith(tuple(work.walls)) else ""
        section = f"{wall!r} among the bodies" if wall else "the camera section"
        raise FitFailed(
            "camera prior",
            pull,
            PRIOR_LIMIT,
            lens
            or _heights_exchanged(work)
            or size_told(work)
            or (SHADOWS if name in (*ASIDE, WIDER) else "")
            or f"{name} would have to be off by {pull:.1f} of its sigmas; check square_mm and {section}"
            " of the scene, or allow more in its fit section",
        )


def size_told(work: Progress) -> str:
    """Say how much larger than described a bare frame shows the board, if no camera near the nominal one would."""
    frame, found = work.bare_frames[0], work.bare[0]
    camera = work.nominal.camera
    view = corners_in_view(work.board, _predict_view(work, frame, work.unknowns.start), camera.shape)
    size = size_seen(found.corners.pixel, found.axes_px, view, work.board)
    longer = dict(zip(work.unknowns.names, work.unknowns.sigma.tolist(), strict=True)).get("camera.focal_px", 0.0)
    nearer = work.priors.camera.position_mm / float(np.linalg.norm(camera.position_mm))
    if size is None or not size.differs(CAMERA_SIGMAS * float(np.hypot(nearer, longer / camera.focal_px))):
        return ""
    return f"{frame.name}: {size.sentence}"


def turn_of_bench(nominal: Camera, seen: Camera, known: FitCameraTable) -> NDArray[np.float64]:
    """Rotation matrix B (3, 3) of the bench, as seen from the board.

    Parameters
    ----------
    nominal, seen : Camera
        As described, and as the bare board shows it.
    known : FitCameraTable
        Sigmas of the camera's pose.
    """
    place, rows = np.array(nominal.position_mm), nominal.rotation_matrix
    spread_mm, spread = max(known.position_mm, 1e-3), np.deg2rad(max(known.rotation_deg, 1e-3))

    def misses(turn: NDArray[np.float64]) -> NDArray[np.float64]:
        bench = scipy.spatial.transform.Rotation.from_rotvec(turn).as_matrix()
        left = scipy.spatial.transform.Rotation.from_matrix(seen.rotation_matrix @ bench @ rows.T).as_rotvec()
        away = np.array(seen.position_mm) - bench @ place
        return np.concatenate((away / spread_mm, left / spread, turn / np.deg2rad(LARGE_DEG)))

    start = scipy.spatial.transform.Rotation.from_matrix(seen.rotation_matrix.T @ rows).as_rotvec()
    return np.asarray(
        scipy.spatial.transform.Rotation.from_rotvec(scipy.optimize.least_squares(misses, start).x).as_matrix()
    )


def turn_scene(scene: Scene, turn: NDArray[np.float64]) -> Scene:
    """Return the scene turned as a whole about the world's origin, its spheres clear of the plane."""

    def point(world: Vector3) -> Vector3:
        x, y, z = turn @ np.array(world)
        return float(x), float(y), float(z)

    a, b, c = ((float(r[0]), float(r[1]), float(r[2])) for r in scene.camera.rotation_matrix @ turn.T)
    camera = replace(scene.camera, position_mm=point(scene.camera.position_mm), rotation=(a, b, c))
    spheres = scene.sphere_table()
    spheres[:, :3] = spheres[:, :3] @ turn.T
    places = map(vector3, push_apart(spheres)[:, :3])
    placed = {s.name: replace(s, centre_mm=place) for s, place in zip(scene.spheres, places, strict=True)}
    balls = tuple(placed.values())
    bodies = tuple(
        placed.get(body.name) or (body.moved(point) if body.room else clear_of(body.moved(point), balls))
        for body in scene.bodies
    )
    return replace(scene, camera=camera, bodies=bodies)


def in_words(turn: NDArray[np.float64]) -> str:
    """Say how the board hangs."""
    about_x, about_y, about_z = (
        -np.rad2deg(scipy.spatial.transform.Rotation.from_matrix(turn).as_rotvec())
    ).tolist()
    return (
        f"the board is turned by {about_z:+.1f} deg in its plane and leans by {about_x:+.1f} deg about x and"
        f" {about_y:+.1f} deg about y against the scene; the world follows the board, camera and glass with it"
    )
