"""Plates as makers sell them, drawn by the simulator: rows upright or staggered, one level or two, six origins."""

from dataclasses import dataclass, replace

import numpy as np

from correction.target import Chessboard
from correction.target.board_search import track_board
from sim.renderer.patterns import DotGrid, Plate
from sim.renderer.render import render_irradiance
from sim.renderer.sensor import Sensor
from tests.correction.target.drawn_boards import AWAY_MM, OFF_DEG, OFF_MM, REACH_MM, VIEW_MM, camera
from tracer.board import LARGE_DOTS, Dots
from tracer.scene.scene import Scene

ORIGINS = ("three large dots", "square and triangle", "missing dots", "one large dot", "pointed at", "counted")
DISCS = {
    "three large dots": LARGE_DOTS,
    "square and triangle": ((-3, 1), (0, -3)),
    "missing dots": ((0, 0), (2, 1)),
    "one large dot": ((0, 0),),
}
MARKS = {"square and triangle": "between", "missing dots": "missing"}


@dataclass(frozen=True)
class Drawn:
    """One frame of a plate, what is said of it, and the cameras that saw it and that is believed."""

    image: np.ndarray
    board: Chessboard
    true: object
    nominal: object
    about: str

    def find(self):
        """Found dots, and how far (N,) they are from where they are [px]."""
        found = track_board(self.image, self.board, self.nominal.project, reach=REACH_MM / self.board.square_mm)
        off = found.position_px - self.true.project(found.board.place_mm(found.index))
        return found, np.linalg.norm(off, axis=1)


def printed(board):
    """The real thing."""
    keep = {name: getattr(board, name) for name in ("discs", "squares", "origin_corner", "dots", "staggered")}
    kind = Plate if board.dots.levels else DotGrid
    return kind(board.square_mm, board.disc_mm, **keep)


def plate(seed):
    """A plate by its number; staggered, on two levels and with each of the origins by turns."""
    rng = np.random.default_rng((seed, 77))
    origin, staggered, levels = ORIGINS[seed % 6], bool(seed // 6 % 2), bool(seed // 12 % 2)
    staggered |= levels and origin in MARKS  # as they are sold
    if levels and origin == "one large dot":
        origin = "three large dots"
    side, dot = float(rng.uniform(2.6, 4.0)), float(rng.uniform(0.28, 0.42))
    step_mm = float(rng.uniform(0.15, 0.4) * side * rng.choice((1.0, -1.0)))
    by = "staggered" if staggered else str(rng.choice(("rows", "columns", "alternating")))
    discs, marks = DISCS.get(origin, ()), MARKS.get(origin, "large")
    triangle = discs[1] if marks == "between" else None
    dots = Dots(dot * side, levels or bool(rng.integers(2)), marks=marks, triangle=triangle)
    squares = None
    if origin == "counted":
        fits = np.floor(0.75 * np.array(VIEW_MM) / side * (2.0**0.5 if staggered else 1.0))
        squares = tuple(fits.astype(int).tolist())
    large = side * dot * (1.5 if marks == "large" and discs else 1.0)
    board = Chessboard(side, large, discs=discs, dots=dots, staggered=staggered, squares=squares)
    if levels:
        dots = replace(dots, levels=by, step_mm=step_mm)
        board = replace(board, dots=dots, step_sigma_mm=0.01, scale_sigma=(1e-4, 1e-4))
    return (
        board,
        f"{seed}: {origin}, {'staggered' if staggered else 'upright'}, {'two levels' if levels else 'flat'}",
    )


def drawn(seed):
    """A frame of a plate by its number, tilted by up to 25 degrees, by a camera that is believed elsewhere."""
    (board, about), rng = plate(seed), np.random.default_rng((seed, 78))
    tilt, towards = np.deg2rad(rng.uniform(0.0, 25.0)), rng.uniform(0.0, 2.0 * np.pi)
    place = AWAY_MM * np.array((np.sin(tilt) * np.cos(towards), np.sin(tilt) * np.sin(towards), np.cos(tilt)))
    aim = AWAY_MM * np.tan(np.deg2rad(OFF_DEG)) * rng.uniform(-0.6, 0.6, 2)
    roll, k1 = np.deg2rad(OFF_DEG) * rng.uniform(-2.0, 2.0), float(rng.uniform(-1.0, 0.5))
    true = camera(place + OFF_MM * rng.uniform(-1.0, 1.0, 3), aim, roll, k1)
    light = render_irradiance(Scene(true, ()), printed(board), samples=3, seed=seed)
    light = light * (1.0 + rng.uniform(-0.5, 0.5) * np.linspace(-1.0, 1.0, light.shape[1]))
    image = Sensor().expose(light.astype(np.float32), seed=seed, illumination=float(rng.uniform(0.25, 1.0)))
    if "pointed at" in about:
        at = true.project(np.zeros(3)) + 1.3 * board.square_mm * rng.uniform(-1.0, 1.0, 2)
        board = replace(board, origin_px=tuple(at.tolist()))
    return Drawn(image, board, true, camera(place, (0.0, 0.0), 0.0), about)
