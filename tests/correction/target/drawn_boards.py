"""Boards as labs hang them: kinds and sizes, a camera that is not where it was believed, bad light, hidden parts.

Drawn by the simulator, whose patterns share no arithmetic with what finds them.  `verdict` says what came of one.
"""

from collections import Counter
from dataclasses import dataclass, replace

import cv2
import numpy as np

from correction.errors import TargetNotFound
from correction.target import Chessboard
from correction.target.board_search import track_board
from correction.target.codes import with_codes
from sim.renderer.patterns import Chessboard as Print
from sim.renderer.patterns import CodedBoard, DotGrid, Plate, Pose, place
from sim.renderer.render import render_irradiance
from sim.renderer.sensor import Sensor
from tracer.board import LARGE_DOTS, Codes, Dots
from tracer.bodies import Sphere
from tracer.camera import Camera, Lens, look_at
from tracer.media import ConstantMedium
from tracer.scene.scene import Scene

SIZE_PX = (320, 270)
FOCAL_PX, AWAY_MM = 1600.0, 300.0
VIEW_MM = tuple(side * AWAY_MM / FOCAL_PX for side in SIZE_PX)
OFF_MM, OFF_DEG = 5.0, 3.0  # of the camera, from where it is believed
REACH_MM = 3.0 * np.hypot(
    2.0, np.deg2rad(2.0) * AWAY_MM
)  # three sigmas of what a scene's fit section says unasked
KINDS = ("discs", "plain", "charuco", "dots")  # and "plate", where asked for
STRAY_PX, STRAYS = 1.0, 0.03
FINE = 4  # parts of a pixel along a side, where something covers the board


@dataclass(frozen=True)
class Drawn:
    """One frame, what it shows, and what is believed of it."""

    image: np.ndarray
    kind: str
    board: Chessboard
    nominal: Camera
    true: Camera
    about: str


def camera(position_mm, aim_mm, roll, k1=0.0):
    """A camera that looks at a point of the board."""
    middle = ((SIZE_PX[0] - 1) / 2.0, (SIZE_PX[1] - 1) / 2.0)
    position = tuple(map(float, position_mm))
    rotation = look_at(position, (*map(float, aim_mm), 0.0), float(roll))
    return Camera(FOCAL_PX, middle, SIZE_PX, position, rotation, Lens(k1=k1))


NOMINAL = camera((0.0, 0.0, AWAY_MM), (0.0, 0.0), 0.0)


def drawn(seed, kind=None):
    """Draw a board by its number, of a kind by turns where none is given."""
    rng = np.random.default_rng((seed, 3))
    kind = kind or KINDS[seed % len(KINDS)]
    square = float(rng.uniform(2.2, 4.2))
    squares = tuple(int(n) for n in rng.integers(6, 34, 2))
    origin = tuple(int(rng.integers(1, n)) for n in squares) if rng.random() < 0.3 else None
    if (
        kind == "plain" and seed // len(KINDS) % 2
    ):  # one that fits into the frame: nothing else of it says where it is
        squares = tuple(min(n, int(0.8 * side / square)) for n, side in zip(squares, VIEW_MM, strict=True))
        origin = None if origin is None else tuple(min(o, n - 1) for o, n in zip(origin, squares, strict=True))
    if kind == "charuco":
        square, squares = 1.5 * square, tuple(min(n, 20) for n in squares)
        origin = None if origin is None else tuple(min(o, n - 1) for o, n in zip(origin, squares, strict=True))
    marks = {} if kind == "discs" else {"discs": ()}
    board = Chessboard(square, 0.4 * square, squares=squares, origin_corner=origin, **marks)
    codes = Codes("DICT_4X4_1000", 0.7, "new")
    board = with_codes(board, codes) if kind == "charuco" else board
    if kind in ("dots", "plate"):
        of_dots = np.random.default_rng((seed, 5))
        dot = float(of_dots.uniform(0.3, 0.5))
        marks = {"dots": Dots(dot * square, bool(of_dots.integers(2))), "discs": LARGE_DOTS}
        large = min(dot * float(of_dots.uniform(1.4, 1.7)), 0.7) * square
        if kind == "plate":
            step, levels = (
                float(of_dots.uniform(0.5, 1.5)),
                str(of_dots.choice(("rows", "columns", "alternating"))),
            )
            step *= float(of_dots.choice((1.0, -1.0)))
            marks["dots"] = replace(marks["dots"], levels=levels, step_mm=step)
        board = replace(board, disc_mm=large, **marks)
    if kind == "plain" and rng.random() < 0.15:
        board = replace(board, squares=None)
    aim = AWAY_MM * np.tan(np.deg2rad(OFF_DEG)) * rng.uniform(-1.0, 1.0, 2)
    position = np.array((0.0, 0.0, AWAY_MM)) + OFF_MM * rng.uniform(-1.0, 1.0, 3)
    k1 = float(rng.uniform(-1.5, 0.5)) if rng.random() < 0.5 else 0.0
    true = camera(position, aim, np.deg2rad(OFF_DEG) * rng.uniform(-1.0, 1.0), k1)
    on_paper = {**marks, "squares": squares, "origin_corner": origin}
    if kind == "dots":
        real = DotGrid(square, large, **on_paper)
    elif kind == "plate":
        real = Plate(square, large, **on_paper)
    elif kind == "charuco":
        real = CodedBoard(square, codes=codes, **on_paper)
    else:
        odd_bright = kind != "plain" or bool(rng.integers(2))
        real = Print(square, 0.4 * square, odd_bright=odd_bright, **on_paper)
    balls = balls_before(seed)
    if kind == "plate":  # whose face may lie before the plane
        balls = tuple(ball for ball in balls if ball.centre_mm[2] - ball.radius_mm > 1.6)
    light = render_irradiance(Scene(true, balls), place(real, Pose()), samples=3, seed=seed)
    light, words = _as_a_lab_sees_it(light, true, board, squares, rng)
    words += f", {len(balls)} balls" if balls else ""
    image = Sensor().expose(light.astype(np.float32), seed=seed, illumination=float(rng.uniform(0.25, 1.0)))
    return Drawn(image, kind, board, NOMINAL, true, f"{kind} {seed}: {square:.2f} mm, {squares}, {words}")


def balls_before(seed):
    """None to three balls of glass between board and camera, apart from each other."""
    rng, balls = np.random.default_rng((seed, 4)), []
    for _ in range(rng.choice(4, p=(0.4, 0.2, 0.2, 0.2))):
        radius = float(rng.uniform(4.0, 9.0))
        centre = np.array((*rng.uniform(-20.0, 20.0, 2), radius + rng.uniform(0.2, 30.0)))
        if all(np.linalg.norm(centre - ball.centre_mm) > radius + ball.radius_mm for ball in balls):
            place = tuple(centre.tolist())
            balls.append(Sphere(f"ball{len(balls)}", place, radius, ConstantMedium(1.517)))
    return tuple(balls)


def _as_a_lab_sees_it(light, true, board, squares, rng):
    """End the paper somewhere, put something before it, and light it unevenly."""
    words = []
    if rng.random() < 0.7:
        columns, rows = squares
        x, y = board.origin_corner or (columns // 2, rows // 2)
        margin = rng.uniform(0.2, 3.0)
        low, high = np.array((-x, -y)) - margin, np.array((columns - x, rows - y)) + margin
        outline = np.array([(low[0], low[1]), (high[0], low[1]), (high[0], high[1]), (low[0], high[1])])
        paper = true.project(np.column_stack((outline * board.square_mm, np.zeros(4))))
        if np.isfinite(paper).all():
            light = _laid(light, 1.0 - _cover(paper), float(rng.uniform(0.0, 1.0)))
        words.append(f"{margin:.1f} squares of paper around")
    if rng.random() < 0.5:
        share = float(rng.uniform(0.05, 0.5))
        angle = rng.uniform(0.0, 2.0 * np.pi)
        across = np.array((np.cos(angle), np.sin(angle)))
        v, u = np.indices(light.shape)
        far = u * across[0] + v * across[1]
        edge = across * np.quantile(far, 1.0 - share)
        along, out = 2000.0 * np.array((-across[1], across[0])), 2000.0 * across
        hand = np.array([edge - along, edge + along, edge + along + out, edge - along + out])
        light = _laid(light, _cover(hand), float(rng.uniform(0.0, 1.0)))
        words.append(f"{100.0 * share:.0f} % hidden")
    v, u = np.indices(light.shape) / max(light.shape) - 0.5
    slope = rng.uniform(-0.8, 0.8, 2)
    return light * (1.0 + slope[0] * u + slope[1] * v), ", ".join(words)


def _cover(outline_px):
    """Share (H, W) of each pixel within a polygon."""
    fine = np.zeros((SIZE_PX[1] * FINE, SIZE_PX[0] * FINE), np.float32)
    at = np.rint(((np.asarray(outline_px) + 0.5) * FINE - 0.5) * 16.0).astype(np.int32)
    cv2.fillPoly(fine, [at], 1.0, shift=4)
    return cv2.resize(fine, SIZE_PX, interpolation=cv2.INTER_AREA)


def _laid(light, cover, shade):
    return light * (1.0 - cover) + shade * cover


def verdict(one):
    """Say "right", "refused", or by what it is wrong; and the rms of what is right, in px."""
    try:
        found = track_board(one.image, one.board, one.nominal.project, reach=REACH_MM / one.board.square_mm)
    except TargetNotFound as error:
        return "refused", str(error)
    there = one.true.project(one.board.place_mm(found.index))
    off = np.linalg.norm(found.position_px - there, axis=1)
    side = np.linalg.norm(found.axes_px, axis=1).mean(axis=1)
    astray = off > STRAY_PX  # where an edge of something else crosses one of a square; a fit leaves them out
    if (off < 0.3 * side).all() and astray.sum() <= max(1.0, STRAYS * len(off)):
        return "right", float(np.sqrt(np.mean(off[~astray] ** 2) / 2.0))
    return f"wrong: {np.count_nonzero(astray)} of {len(off)} corners, by {off.max():.1f} px", one.about


def counted(kind, seeds):
    """How many of a kind are right and refused, what is wrong, and the rms of those that are right [px]."""
    found = [verdict(drawn(seed, kind)) for seed in seeds]
    count = Counter(said.split(":")[0] for said, _ in found)
    wrong = [one for one in found if one[0].startswith("wrong")]
    return count, wrong, [off for said, off in found if said == "right"]
