"""The board that frames show: what their run says; of lone files, what the options say."""

from collections.abc import Iterable
from pathlib import Path

from correction.errors import BoardError
from correction.target import Chessboard
from daq.runs.acquired import run_of
from daq.runs.run_folder import RunFolder
from daq.runs.run_views import is_run


def board_of(paths: Iterable[Path], square_mm: float | None = None, disc_mm: float | None = None) -> Chessboard:
    """Return the board of runs, of frames of runs, or of files that belong to none.

    Parameters
    ----------
    paths : iterable of Path
        Run folders and frames.
    square_mm, disc_mm : float, optional
        What somebody says of the board; otherwise squares are those of `Chessboard`, and discs as wide in them.

    Raises
    ------
    BoardError
        Somebody says another thing than a run, or two runs differ.
    RunUnsuitable, RunDamaged
        A run cannot be read.
    """
    runs = {found.path: found for path in paths if (found := RunFolder(path) if is_run(path) else run_of(path))}
    said = {"square_mm": square_mm, "disc_mm": disc_mm}
    by = dict.fromkeys(said, "the options say")
    for path, run in runs.items():
        about = run.about
        for name, value in (("square_mm", about["square_mm"]), ("disc_mm", about.get("disc_mm"))):
            if value is None:
                continue
            before = said[name]
            if before is not None and before != value:
                raise BoardError(
                    f"{path}: the board of this run has {name} {value:g}, {by[name]} {before:g}; a run knows its "
                    "board, so leave the option out, and take frames of one board at a time"
                )
            said[name], by[name] = value, f"{path} says"
    usual = Chessboard()
    square = said["square_mm"] or usual.square_mm
    return Chessboard(square, said["disc_mm"] or usual.disc_mm / usual.square_mm * square)
