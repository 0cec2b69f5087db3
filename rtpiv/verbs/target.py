"""`rtpiv setup target`: write a calibration target to print, or record the size of a print."""

import json
import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from daq.errors import RunUsageError
from ground.terminal import console
from rtpiv.verbs.paths import Named, file_of
from rtpiv.verbs.results import results_in
from tracer.scene.scene import Scene
from tracer.scene.scene_file import load_scene

if TYPE_CHECKING:
    from correction.target.board_file import PrintedBoard

PLAIN_MM, PLAIN_PX_PER_MM = 2.5, 12.0  # where no scene says what suits it: the squares and the scale of the paper
FAR = 0.05  # no printer stretches by so much: fitted to the page, or x and y exchanged


@dataclass(frozen=True)
class Target:
    """Printed target.

    Parameters
    ----------
    board : PrintedBoard
        The printed board.
    pages : (int, int)
        Columns and rows of pages.
    path : Path
        The file.
    """

    board: "PrintedBoard"
    pages: tuple[int, int]
    path: Path


def target(
    scene: Named | Scene | None = None,
    /,
    measured_mm: tuple[float, float] | None = None,
    kind: Literal["chessboard", "charuco", "charuco-legacy", "dots", "particles"] = "chessboard",
    paper: Literal["A4", "A3", "A2", "letter"] = "A4",
    square_mm: float | None = None,
    size_mm: tuple[float, float] | None = None,
    seed: int = 1,
    out: Named | None = None,
) -> Target:
    """Write a target to print, as PDF at true size; or write down how large the printer made it.

    Parameters
    ----------
    scene : path or Scene, optional
        scene.yaml: squares are chosen for its glass and camera, and the number of corners seen through each ball
        is listed.  Or board.yaml, of `rtpiv init` for example: its chessboard is printed, or with `measured_mm`
        the size of the print is recorded.  Without either, squares of 2.5 mm.
    measured_mm : (float, float), optional
        Measured lengths of the bars along x and y in the margin: recorded in the board file, nothing is drawn.
    kind : {"chessboard", "charuco", "charuco-legacy", "dots", "particles"}
        Kind of target.  Legacy is the layout of OpenCV before 4.6 and of calib.io, which differs where the number
        of rows is even.  Particles are for shift runs: a printed flow.
    paper : {"A4", "A3", "A2", "letter"}
        Paper of the printer.
    square_mm : float, optional
        Side of the squares, or pitch of the dots, instead of the automatic choice; rounded to whole printer dots
        (1/600 inch), since unevenly spaced lines cause larger errors than noise.
    size_mm : (float, float), optional
        Width and height of the target, on several pages if necessary.  Default: one page.
    seed : int
        Seed of particles: the same seed prints the same page.
    out : path, optional
        Folder, default ``target`` (or ``target-2`` ... where that has results): ``target.pdf`` and ``board.yaml``,
        which says what is printed.

    Returns
    -------
    Target
        The board, pages and the file that was written.

    Raises
    ------
    ConfigError
        The scene file is wrong.
    SceneError
        The squares do not fit the target.
    RunUsageError, DiskError
        The folder cannot hold results.
    """
    from correction.target.board_file import PrintedBoard, write_board
    from rtpiv.analysis.prints import pages, sheets
    from rtpiv.analysis.prints.choice import best_square, corners_of

    if kind == "particles" and square_mm is not None:
        raise RunUsageError("particles have no squares", cure="leave --square-mm out, or choose another --kind")
    if measured_mm is not None:
        return _record_measure(scene, measured_mm)
    screen = console()
    described = None if scene is None or isinstance(scene, Scene) else _board_in(file_of(scene))
    drawn_from = Path() if described is None or scene is None else file_of(scene)
    if described is not None:
        if square_mm is not None or kind != "chessboard":
            raise RunUsageError("says what is printed", place=drawn_from, cure="leave --kind and --square-mm out")
        kind, square_mm, scene = described.kind, described.square_mm, None
    loaded = scene if scene is None or isinstance(scene, Scene) else load_scene(file_of(scene))
    size = size_mm or pages.room_on(paper)
    with results_in(out, "target") as folder:
        if kind == "particles":
            scale = (
                PLAIN_PX_PER_MM if loaded is None else loaded.camera.focal_px / abs(loaded.camera.position_mm[2])
            )
            sheet = sheets.particles(size, scale, seed)
            words = f"rtpiv particles, {sheet.particle_mm:.3g} mm, seed {seed}."
        else:
            if loaded is not None:
                seen = (
                    best_square(loaded, size, "charuco" in kind)
                    if square_mm is None
                    else corners_of(loaded, pages.whole_dots(square_mm), size)
                )
                square_mm = seen.square_mm
                screen.print(seen.sentence)
            square_mm = pages.whole_dots(square_mm or PLAIN_MM)
            if "charuco" in kind:
                sheet = sheets.charuco(size, square_mm, "legacy" if kind == "charuco-legacy" else "new")
            else:
                sheet = (sheets.dots if kind == "dots" else sheets.chessboard)(size, square_mm)
            words = f"rtpiv {kind}, {square_mm:.4g} mm."
        if described is not None:
            said = described.model_dump(include=set(sheet.about), exclude_none=True)
            said["disc_mm"] = described.disc_mm
            other = [key for key, value in said.items() if value != sheet.about[key]]
            if other:
                raise RunUsageError(
                    f"{' and '.join(other)} are not those of a board that is printed here on this paper",
                    place=drawn_from,
                    cure="give its --paper or --size-mm, or print it with the program that made it",
                )
        path = folder / "target.pdf"
        printed = pages.write_pages(path, sheet, paper, words)
        if described is None:
            kept, board = folder / "board.yaml", PrintedBoard(kind=sheet.kind, **sheet.about)
        else:  # what it leaves open, such as the number of squares, stays open
            kept, board = drawn_from, described.model_copy(update={"measured_mm": None})
        board = board.model_copy(update={"bars_mm": list(printed.bars_mm)})
        write_board(kept, board)
        if described is not None and described.measured_mm is not None:
            screen.print(f"{kept}: the measure of an earlier print is taken out", style="bold red")
        columns, rows = printed.pages
        many = "one page" if columns * rows == 1 else f"{columns} x {rows} pages"
        screen.print(
            f"{path}, {many} of {paper}: print at 100 %, then measure the two bars and record them:"
            f" rtpiv setup target {shlex.quote(str(kept))} --measured-mm X Y",
            soft_wrap=True,
            highlight=False,
        )
        if described is None and kind != "particles":
            place = json.dumps(str(kept.absolute()), ensure_ascii=False)  # also YAML, whatever is in it
            screen.print(f"the line for a bench file: target: {{board: {place}}}", soft_wrap=True, highlight=False)
        return Target(board, printed.pages, path)


def _board_in(path: Path) -> "PrintedBoard | None":
    """Return the chessboard that a file describes; None of the file of a scene."""
    from correction.target.board_file import PrintedBoard
    from ground.config import open_document, validate

    document = open_document(path)
    if not isinstance(document.tree, dict) or not {"kind", "plate"} & document.tree.keys():
        return None
    board = validate(document, PrintedBoard)
    if board.kind != "chessboard":
        raise RunUsageError(
            f"is a board of kind {board.kind}", place=path, cure=f"draw a new one with --kind {board.kind}"
        )
    return board


def _record_measure(file: Named | Scene | None, measured_mm: tuple[float, float]) -> Target:
    """Write into a board file what its bars measure on paper."""
    from correction.target.board_file import read_board, write_board

    if file is None or isinstance(file, Scene):
        raise RunUsageError("the bars of which print?", cure="name its board.yaml before --measured-mm")
    path = file_of(file)
    board = read_board(path)
    drawn = board.bars_mm
    if drawn is None:
        raise RunUsageError("has no bars", place=path, cure="give a board.yaml of rtpiv setup target")
    board = board.model_copy(update={"measured_mm": [float(length) for length in measured_mm]})  # of NumPy, too
    far = max(abs(scale - 1.0) for scale in board.scale)
    if far > FAR:
        raise RunUsageError(
            f"bars of {drawn[0]:g} and {drawn[1]:g} mm are said to measure {measured_mm[0]:g} and"
            f" {measured_mm[1]:g} mm",
            place=path,
            cure="print at 100 %, and give x before y in mm",
        )
    write_board(path, board)
    (x, y), (sigma, _) = board.scale, board.scale_sigma
    console().print(f"{path}: the print is {x:.4f} and {y:.4f} as large as drawn, in x and y, each to {sigma:.4f}")
    return Target(board, (0, 0), path)
