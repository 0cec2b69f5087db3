"""board.yaml: what was printed, and how large it came out.

    kind: chessboard
    square_mm: 2.5               # as drawn
    disc_mm: 1.0
    discs: [[0, 0], [0, -1], [-1, -1], [0, 1]]  # no mirror image of it looks the same; without, the first three
    bars_mm: [190.0, 280.0]      # the bars in the margin as drawn, along x and y
    measured_mm: [189.7, 279.9]  # the same on paper, with a steel rule

    kind: dots
    pitch_mm: 3.5                # from dot to dot
    dot_mm: 1.4
    large_dot_mm: 2.3            # of three: the origin, the next one to the right, and the second above

    kind: dots                   # without large dots: see `correction.target.board_count` for where the origin is
    pitch_mm: 5.0
    dot_mm: 2.0
    squares: [12, 10]            # of 11 x 9 dots
    origin_px: [803.0, 611.0]    # or so: the dot at the origin in the bare frame at z = 0

    kind: dots                   # a plate, machined, with two levels of dots
    pitch_mm: 5.0
    dot_mm: 1.5
    large_dot_mm: 2.5
    bright_dots: true
    levels: rows                 # every second row is on the other level; or columns, or alternating
    step_mm: 1.0                 # behind that of the origin, which is the plane of the target

    plate: lavision-106-10       # kind, pitch, rows, levels and step of that plate (`correction.target.makers`)
    dot_mm: 2.0                  # as measured
    marks_mm: {square: [-30.0, -5.0], triangle: [20.0, 5.0]}  # in the middle of four dots, from that at the origin

A printer's scale is measured over drawn, for x and y apart (see `rtpiv.analysis.prints.pages`).  If it
is not measured, it is 1 with a standard uncertainty of 0.5 %, as printers differ; of a plate 0.01 %, as its makers
state.  A bench names the file (`target: {board: board.yaml}`), a run keeps it.
"""

from dataclasses import replace
from math import sqrt
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import yaml
from pydantic import Field, model_validator

from correction.errors import BoardError
from correction.target.chessboard import LINES, STAGGERED, Chessboard
from correction.target.codes import with_codes
from correction.target.makers import with_plate
from ground.config import Pair, Table, read
from ground.whole_file import whole_file
from tracer.board import LARGE_DOTS, OLDER, Codes, Dots, Square

Positive = Annotated[float, Field(gt=0.0, le=1e6)]
READ_MM = 0.1  # of a bar, with a steel rule and a magnifier
UNMEASURED = 0.005  # by which printers stretch
MACHINED, MACHINED_MM = 1e-4, 0.01  # by which the pitch of a plate is off, and its step
OFF_MIDDLE = 0.15  # pitches that a mark between dots may be off their middle, as measured
DEEPEST = 0.8  # pitches: a step beyond hides dots at oblique viewing
SIZES = {
    "chessboard": ("square_mm",),
    "charuco": ("square_mm", "marker_mm", "squares", "dictionary", "origin_corner"),
    "dots": ("pitch_mm", "dot_mm"),
    "particles": ("particles", "particle_mm", "seed", "size_mm"),
}
HEAD = "# What was printed, by `rtpiv setup target`; measured_mm: the bars in the margin on paper, along x and y\n"


class PrintedBoard(Table):
    """A board file.

    Parameters
    ----------
    kind : {"chessboard", "charuco", "dots", "particles"}
        What is printed.
    bars_mm, measured_mm : (float, float)
        Bars along x and y, as drawn and as measured on paper [mm].
    read_sigma_mm : float
        Standard deviation of such a reading.
    square_mm, disc_mm : float, optional
        Of a chessboard, plain without `disc_mm`; squares of a charuco board.
    discs : list, optional
        Squares of a chessboard with a disc, columns and rows from the origin; default the three of older boards.
    squares, origin_corner : optional
        How many there are, columns and rows, and the corner that is the origin, counted from the lower left one.
    marker_mm, dictionary : optional
        Of a charuco board: its markers, and OpenCV's name of the set.
    layout : {"new", "legacy"}, optional
        Which squares of a charuco board with an even number of rows carry markers: legacy, as OpenCV before 4.6,
        calib.io and others print it, with a bright square in the upper left corner. Default: as a frame shows it,
        and new for a board with bars, which `rtpiv setup target` has drawn.
    pitch_mm, dot_mm, large_dot_mm : float, optional
        Of dots: from one to the next along a row, and diameters of the usual and of the large ones.
    large_dots, bright_dots : optional
        Which are large, columns and rows from the origin, and whether dots are bright on dark.
    rows : {"staggered"}, optional
        Rows of dots half a pitch apart, every second one displaced by half a pitch; `squares`, `origin_corner`
        and places of dots then count half pitches and rows.
    marks_mm : mapping, optional
        Of dots: where a ``square``, a ``triangle`` or one ``other`` mark stands in the middle of four, x and y
        from the origin, which they show.
    missing_dots : list, optional
        Dots that are left out and show the origin, columns and rows from it.
    plate : str, optional
        Name of a plate in `correction.target.makers`, whose lines the file then has; those in the file count.
    origin_px : (float, float), optional
        Of dots without such marks: u and v of the one at the origin, in the bare frame at z = 0.
    levels, step_mm : optional
        Of a plate: which dots are on another level than the origin (``rows``: every second row), and how far it
        lies behind; negative, before.
    step_sigma_mm : float
        Standard deviation of that.
    particles, particle_mm, seed, size_mm : optional
        Of particles: how many, how wide, drawn from which seed on which area.
    """

    plate: str | None = None
    kind: Literal["chessboard", "charuco", "dots", "particles"]
    square_mm: Positive | None = None
    disc_mm: Positive | None = None
    discs: list[Annotated[list[int], Field(min_length=2, max_length=2)]] | None = None
    marker_mm: Positive | None = None
    squares: Annotated[list[int], Field(min_length=2, max_length=2)] | None = None
    dictionary: str | None = None
    layout: Literal["new", "legacy"] | None = None
    origin_corner: Annotated[list[int], Field(min_length=2, max_length=2)] | None = None
    pitch_mm: Positive | None = None
    dot_mm: Positive | None = None
    large_dot_mm: Positive | None = None
    large_dots: list[Annotated[list[int], Field(min_length=2, max_length=2)]] | None = None
    bright_dots: bool | None = None
    rows: Literal["staggered"] | None = None
    marks_mm: Annotated[dict[Literal["square", "triangle", "other"], Pair], Field(min_length=1)] | None = None
    missing_dots: (
        Annotated[list[Annotated[list[int], Field(min_length=2, max_length=2)]], Field(min_length=1)] | None
    ) = None
    origin_px: Pair | None = None
    levels: Literal["rows", "columns", "alternating"] | None = None
    step_mm: Annotated[float, Field(ge=-1e3, le=1e3)] | None = None
    step_sigma_mm: Positive | None = None
    particles: int | None = None
    particle_mm: Positive | None = None
    seed: int | None = None
    size_mm: Pair | None = None
    bars_mm: Pair | None = None
    measured_mm: Pair | None = None
    read_sigma_mm: Positive = READ_MM

    @model_validator(mode="before")
    @classmethod
    def _as_its_maker_says(cls, said: object) -> object:
        return with_plate(said) if isinstance(said, dict) and "plate" in said else said

    @model_validator(mode="after")
    def _has_its_sizes(self) -> "PrintedBoard":
        missing = [key for key in SIZES[self.kind] if getattr(self, key) is None]
        if missing:
            raise ValueError(f"kind {self.kind} needs {', '.join(missing)}")
        if (self.levels is None) != (self.step_mm is None) or (self.levels is not None and self.kind != "dots"):
            raise ValueError(
                "a plate is of kind dots and needs levels and step_mm, the distance between its two levels"
            )
        if self.step_sigma_mm is not None and self.levels is None:
            raise ValueError("step_sigma_mm, the uncertainty of a plate's step, needs levels and step_mm")
        if self.step_mm is not None and not 0.0 < abs(self.step_mm) <= DEEPEST * self._side_mm:
            raise ValueError(
                f"step_mm is not 0 and at most {DEEPEST:g} of pitch_mm; a deeper level is hidden at"
                " oblique viewing"
            )
        if self.large_dots is not None and self.large_dot_mm is None:
            raise ValueError("large_dots, the places of large dots, needs large_dot_mm, their diameter")
        marks = [self.large_dot_mm, self.marks_mm, self.missing_dots, self.origin_px]
        if sum(one is not None for one in marks) > (self.kind == "dots"):
            raise ValueError(
                "large_dot_mm, marks_mm, missing_dots and origin_px are the origin of dots; say one of them, or"
                " leave it out"
            )
        if self.rows is not None and (self.kind != "dots" or self.levels not in (None, "rows")):
            raise ValueError("rows are staggered of dots, whose levels change from row to row (levels: rows)")
        if self.layout is not None and self.kind != "charuco":
            raise ValueError("layout is that of the markers of a charuco board; leave it out")
        if self.measured_mm is not None and self.bars_mm is None:
            raise ValueError("measured_mm, the length of bars on paper, needs bars_mm, the length as drawn")
        return self

    def board(self) -> Chessboard:
        """Return what is looked for in frames.

        Raises
        ------
        BoardError
            Nothing of this kind can be, or cannot be printed.
        """
        if self.kind == "particles":
            raise BoardError(
                "a board of kind particles has no corners to calibrate by; take a chessboard, charuco or dots"
            )
        side = self._side_mm
        board = Chessboard(side, discs=(), scale=self.scale, scale_sigma=self.scale_sigma)
        if self.kind == "dots":
            assert self.dot_mm is not None
            marks, discs = self._dots_of_origin()
            levels = "staggered" if self.rows and self.levels else self.levels or ""
            named = zip(self.marks_mm or (), discs, strict=False)
            triangle = next((disc for name, disc in named if name == "triangle"), None)
            dots = Dots(self.dot_mm, bool(self.bright_dots), levels, self.step_mm or 0.0, marks, triangle)
            origin = None if self.origin_px is None else (self.origin_px[0], self.origin_px[1])
            wide = self.large_dot_mm or self.dot_mm
            board = replace(
                board, disc_mm=wide, discs=discs, dots=dots, origin_px=origin, staggered=self.rows is not None
            )
            if self.levels is not None:
                board = replace(board, step_sigma_mm=self.step_sigma_mm or MACHINED_MM)
        elif self.disc_mm is not None:
            discs = OLDER if self.discs is None else tuple((i, j) for i, j in self.discs)
            board = replace(board, disc_mm=self.disc_mm, discs=discs)
        if self.squares is not None:
            columns, rows = self.squares
            x, y = self.origin_corner or (columns // 2, rows // 2)
            board = replace(board, squares=(columns, rows), origin_corner=(x, y))
        if self.kind == "charuco":
            assert self.marker_mm is not None
            assert self.square_mm is not None
            assert self.dictionary is not None
            layout = self.layout or ("" if self.bars_mm is None else "new")  # bars are of `rtpiv setup target`
            board = with_codes(board, Codes(self.dictionary, self.marker_mm / self.square_mm, layout))
        return board

    @property
    def _side_mm(self) -> float:
        """Side of a square of the lattice, which stands on a corner where rows are staggered."""
        side = self.pitch_mm if self.kind == "dots" else self.square_mm
        assert side is not None
        return side * sqrt(0.5) if self.rows else side

    def _dots_of_origin(self) -> tuple[str, tuple[Square, ...]]:
        """Marks of the origin of dots (`Dots.marks`) and where they are: dots, or squares between dots."""
        if self.marks_mm is not None:
            place = np.array(list(self.marks_mm.values())) / self._side_mm
            cells = (place @ STAGGERED if self.rows else place) - 0.5
            off = np.abs(cells - np.rint(cells)).max()
            if off > OFF_MIDDLE:
                raise BoardError(
                    f"marks_mm are the middles of marks between dots, and one is {off:.2g} pitches off the middle"
                    " of four dots; measure it from the dot at the origin"
                )
            return "between", tuple((round(i), round(j)) for i, j in cells.tolist())
        named = self.large_dots if self.missing_dots is None else self.missing_dots
        if self.large_dot_mm is None and self.missing_dots is None:
            return "large", ()
        lines = np.array(LARGE_DOTS if named is None else named)
        if self.rows and named is None:
            raise BoardError("say large_dots of staggered rows: half pitches and rows from the origin")
        if self.rows and (lines.sum(axis=1) % 2).any():
            raise BoardError("no dot stands there: a row of odd number has dots at odd half pitches alone")
        index = lines @ LINES // 2 if self.rows else lines
        return "large" if self.missing_dots is None else "missing", tuple((i, j) for i, j in index.tolist())

    @property
    def scale(self) -> tuple[float, float]:
        """Scale of the paper print against its drawing, in x and in y."""
        if self.measured_mm is None or self.bars_mm is None:
            return 1.0, 1.0
        x, y = (real / drawn for real, drawn in zip(self.measured_mm, self.bars_mm, strict=True))
        return x, y

    @property
    def scale_sigma(self) -> tuple[float, float]:
        """Standard deviations of the scale in x and y."""
        if self.measured_mm is None or self.bars_mm is None:
            own = UNMEASURED if self.levels is None else MACHINED
            return own, own
        x, y = (self.read_sigma_mm / drawn for drawn in self.bars_mm)
        return x, y


def read_board(path: Path | str) -> PrintedBoard:
    """Read a board file; ConfigError with each line that is wrong."""
    return read(path, PrintedBoard)


def board_text(board: PrintedBoard) -> str:
    """Text of a board file."""
    return HEAD + yaml.safe_dump(board.model_dump(exclude_none=True), sort_keys=False, default_flow_style=None)


def write_board(path: Path, board: PrintedBoard) -> None:
    """Write a board file whole; OSError names it if it cannot be written."""
    with whole_file(path) as stream:
        stream.write(board_text(board).encode())
