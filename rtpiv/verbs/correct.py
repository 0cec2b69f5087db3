"""`rtpiv correct`: compute frames as if the glass were not there.

Results are written while the next ones are made, by a thread of its own that holds one (`write_behind`).
"""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from correction.errors import MapUsageError
from correction.evaluate.target_error import TargetError, target_error
from correction.fitted.prepared import prepare
from correction.maps.corrector import UINT16_OFFSET, Corrector, to_uint16
from correction.maps.dewarp import Dewarp
from correction.node_status import MEANING, NodeStatus
from correction.target import Chessboard
from daq.atomic_write import write_json
from daq.errors import RunUsageError
from daq.runs.acquired import ReadAhead
from daq.runs.names import is_run
from daq.runs.run_views import shows_light_sheet, where_lit
from ground.terminal import console, progress
from piv.errors import FrameError
from piv.files.frame_file import stem_of, write_frame
from rtpiv.analysis.fit_beside import scene_sigma_beside
from rtpiv.analysis.gaps import gaps_of_scene
from rtpiv.analysis.pictures.drawing_process import drawing
from rtpiv.analysis.recipe import CorrectionRecipe, Resampling
from rtpiv.analysis.report.table import Table
from rtpiv.analysis.through_glass import through_glass
from rtpiv.verbs.paths import Named, path_of, paths_of
from rtpiv.verbs.results import results_in
from rtpiv.verbs.show import say_through
from tracer.scene.scene import Scene
from tracer.scene.scene_file import load_scene


@contextmanager
def write_behind() -> Iterator[Callable[[Callable[[], None]], None]]:
    """Give what executes calls one after the other in a thread of its own, and waits for the one before.

    When a call fails, the next one or the end of the block raises its error, and no further call begins.
    """
    with ThreadPoolExecutor(1, "rtpiv-results") as writer:
        begun: list[Future[None]] = []

        def write(call: Callable[[], None]) -> None:
            if begun:
                begun.pop().result()
            begun.append(writer.submit(call))

        yield write
        if begun:
            begun.pop().result()


DEWARP_LIMIT_PX = 0.2  # several times the noise of a corner
CELL_PX, PARTICLE_PX = 8.0, 4.0  # of computer-generated particles: seeding that an eye can follow


@dataclass(frozen=True)
class Corrected:
    """Results of `correct`.

    Parameters
    ----------
    frames : tuple of Path
        Corrected frames, in the order of those given.
    mask : Path
        Why nodes are not recovered (NodeStatus).
    recovered : float
        Share of the nodes that are.
    errors : tuple of TargetError
        One a frame if the target was to be checked.
    """

    frames: tuple[Path, ...]
    mask: Path
    recovered: float
    errors: tuple[TargetError, ...]


def correct(
    frames: Sequence[Named] | Named,
    /,
    scene: Named | Scene,
    out: Named | None = None,
    recipe: CorrectionRecipe = CorrectionRecipe(),
    resampling: Resampling = Resampling(),
    check_target: bool = False,
    pictures: bool = True,
    overwrite: bool = False,
) -> Corrected:
    """Correct frames that were taken through the glass of a scene.

    Parameters
    ----------
    frames : list of path, or path
        Acquired frames; all are checked before the first result is written.
    scene : path or Scene
        scene.yaml, nominal or fitted, or in Python the value of `load_scene`.
    out : path, optional
        Folder, default ``corrected`` (or ``corrected-2`` ... where that has results): one TIFF a frame,
        ``mask.tif`` (NodeStatus), ``overview.png`` of the first frame, ``correction.json``.
    recipe : CorrectionRecipe
        Dewarp, and limit of the map uncertainty.
    resampling : Resampling
        Interpolation, number of blended views, and storage of pixels.
    check_target : bool
        The frames show the target: compare its corners with the regular grid.  Other frames, unless a run
        photographed a print, show particles in the light sheet of the scene.
    pictures : bool
        Draw ``overview.png``.
    overwrite : bool
        Overwrite files in the given folder that were made from other input.

    Returns
    -------
    Corrected
        Files, and the share of the plane that is recovered.

    Raises
    ------
    ConfigError, SceneError
        The scene file is wrong.
    FrameError
        A frame is missing, damaged, colour, or of another size.
    RunUsageError
        A run is given in place of its frames.
    BoardError
        A run's board is another one.
    TargetNotFound
        The bare target cannot be read.
    """
    screen = console()
    frames = paths_of(frames)
    for path in frames:
        if is_run(path):
            cure = f"give some of its frames, as in {path / 'frames' / '*.tif'}, or evaluate the run"
            raise RunUsageError("is a run", place=path, cure=cure)
    if recipe.mm_per_px is not None:
        raise MapUsageError("the scene gives the scale; omit --mm-per-px")
    if recipe.second is not None or recipe.both is not None:
        raise MapUsageError("frames are corrected one by one; leave --second and --both to rtpiv evaluate")
    fitted = recipe.apply_mask(scene if isinstance(scene, Scene) else load_scene(scene))
    particles = not check_target and shows_light_sheet(frames)
    loaded = fitted.in_light_sheet() if particles else fitted
    shape = loaded.camera.shape
    _refuse_same_names(frames)
    scene_file = None if recipe.sigma_limit_px is None else path_of(scene)
    source = Path("a scene in memory") if isinstance(scene, Scene) else Path(scene)
    made_from = {f"{stem_of(path)}.tif": path for path in frames}
    made_from |= dict.fromkeys(("mask.tif", "correction.json", *(["overview.png"] if pictures else [])), source)
    with results_in(out, "corrected", overwrite=overwrite, made_from=made_from) as out:
        with ReadAhead(frames, shape) as acquired:
            board = recipe.board(frames)
            dewarp = recipe.dewarp(fitted.camera, board)
            limit = None
            if scene_file is not None:
                limit = recipe.limit(
                    scene_sigma_beside(scene_file, fitted, dewarp is not None, in_light_sheet=particles)
                )
            corrector = prepare(loaded, dewarp, resampling.method, resampling.blend, limit=limit).corrector
            acquired.require_sound()
            grid = corrector.map.grid
            about: dict[str, Any] = {
                "origin_mm": list(grid.origin_mm),
                "scene_hash": loaded.content_hash(),
                "method": resampling.method,
                "dewarp": None if dewarp is None else dewarp.to_dict(),
                "offset": None if resampling.as_float else UINT16_OFFSET,
            }
            errors: list[TargetError] = []
            clipped, shown = list[int](), None

            def store(path: Path, corrected: NDArray[np.float32]) -> None:
                stored, cut = (corrected, 0) if resampling.as_float else to_uint16(corrected)
                clipped.append(cut)
                write_frame(out / f"{stem_of(path)}.tif", stored, grid.px_per_mm, {"source": path.name, **about})

            with write_behind() as write:
                for path, frame in zip(progress(frames, len(frames), "correcting"), acquired, strict=True):
                    corrected = corrector(frame)
                    write(partial(store, path, corrected))
                    if check_target:
                        errors.append(target_error(corrected, corrector, board))
                    shown = shown or (frame, corrected)
        write_frame(
            out / "mask.tif", corrector.status, grid.px_per_mm, {"meaning": list(MEANING.values()), **about}
        )
        counts = np.bincount(corrector.status.ravel(), minlength=len(NodeStatus))
        summary = {**about, "frames": [path.name for path in frames], "clipped_values": sum(clipped)}
        summary["nodes"] = {status.name.lower(): int(counts[status]) for status in NodeStatus}
        shown_share = through_glass(loaded, grid, corrector.recovered)
        summary["through_glass"] = None if shown_share is None else shown_share.share
        summary["target_errors"] = [error.to_dict() for error in errors]
        write_json(out / "correction.json", summary)
        say_through(screen, gaps_of_scene(loaded) or shown_share, loaded)
        _print(screen, loaded, dewarp, corrector, frames, errors)
        if fitted.sheet is not None:
            plane = fitted.sheet.summary if particles else "the target's plane, z = 0, not the light sheet"
            screen.print(f"corrected for {plane}")
        elif particles and (limit is not None or _of_flow(shown)):
            screen.print(where_lit(fitted))
        if pictures and shown is not None:
            _draw(out / "overview.png", loaded, board, *shown, corrector)
        screen.print(f"{len(frames)} frame(s){', mask and overview' if pictures else ' and mask'} are in {out}")
        files = tuple(out / f"{stem_of(path)}.tif" for path in frames)
        return Corrected(files, out / "mask.tif", float(corrector.recovered.mean()), tuple(errors))


def _of_flow(shown: tuple[NDArray[Any], NDArray[np.float32]] | None) -> bool:
    """Return True if the first frame shows particles: frames of no run may show the target."""
    from rtpiv.analysis.pictures.patterns import shows_particles

    return shown is not None and shows_particles(shown[0])


def _refuse_same_names(frames: list[Path]) -> None:
    stems = [stem_of(path) for path in frames]
    for stem in stems:
        if stems.count(stem) > 1 or stem == "mask":
            raise FrameError(
                "two results would have this name", place=stem, cure="rename the frame or use two runs"
            )


def _draw(
    path: Path,
    scene: Scene,
    board: Chessboard,
    frame: NDArray[Any],
    corrected: NDArray[np.float32],
    corrector: Corrector,
) -> None:
    """Draw a frame as acquired, computer-generated (no larger than it is drawn), corrected."""
    from rtpiv.analysis.pictures.patterns import Particles, Target, pattern_view, shows_particles
    from rtpiv.analysis.pictures.rasters import WIDEST_PX
    from rtpiv.analysis.through_glass import coarsen_scene

    px_mm = scene.camera.position_mm[2] / scene.camera.focal_px
    particles = Particles(CELL_PX * px_mm, PARTICLE_PX * px_mm)
    pattern = particles if shows_particles(frame) else Target(board)
    computed = pattern_view(coarsen_scene(scene, WIDEST_PX), pattern, samples=2)
    with drawing() as draw:
        draw("rtpiv.analysis.pictures.results:draw_overview", path, frame, computed, corrected, corrector.status)


def _print(
    screen: Console,
    scene: Scene,
    dewarp: Dewarp | None,
    corrector: Corrector,
    frames: list[Path],
    errors: list[TargetError],
) -> None:
    counts = np.bincount(corrector.status.ravel(), minlength=len(NodeStatus))
    share = ", ".join(
        f"{100.0 * counts[status] / corrector.status.size:.1f} % {meaning}"
        for status, meaning in MEANING.items()
        if counts[status]
    )
    screen.print(f"scene {scene.content_hash()}: {share}")
    if dewarp is not None:
        screen.print(f"dewarp: {dewarp.summary()}")
        if dewarp.residual_rms_px > DEWARP_LIMIT_PX and dewarp.order < 5:
            text = f"the lens distorts more than order {dewarp.order} can follow; try --dewarp-order 5"
            screen.print(text, style="bold")
    if errors:
        title = "target corners in the corrected frame against the regular grid [px]"
        columns = ("frame", "region", "corners", "bias x, y", "rms x, y", "largest")
        rows = [(stem_of(path), *row) for path, error in zip(frames, errors, strict=True) for row in error.rows()]
        screen.print(Table(title, columns, rows, left=(0, 1)))
