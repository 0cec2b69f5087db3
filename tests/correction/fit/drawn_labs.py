"""Labs drawn at random, right ones and ones that their file does not describe, with corners as cameras give them.

Corners come from `drawn_optics`, with the errors that fitted corners of rendered frames have: noise of a size that
the window knows, and the lock on the rows of pixels that it does not know (0.004-0.02 px, measured on frames
without noise), which fades as edges lean.  Nothing is rendered: a lab takes a second.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from correction.fit.adjustment import Adjustment
from correction.fit.judge.result import SceneFit
from correction.fit.seen.bent_view import window_bias
from correction.fit.seen.measurement import LostCorners, MeasuredFrame, whitening
from correction.fit.seen.prediction import expect
from correction.fit.seen.smear_test import EdgeSpread
from correction.fit.solve.light import light_uncertainty
from correction.fit.solve.solver import Corners
from correction.fit.solve.unknowns import unknowns_of
from correction.fitted.map_sigma import sigma_at
from correction.fitted.scene_sigma import SceneSigma
from correction.grid import PlaneGrid, grid_of
from correction.maps.correction_map import build_correction_map
from correction.target import Chessboard
from sim.demo.scenes import at_size, demo_scene, misalign
from tests.correction.fit.drawn_optics import Ball, Lab, corners_px, shown_mm
from tracer.light import white_led
from tracer.media import MEDIA, ConstantMedium, Medium
from tracer.scene.fit_section import FitNamedTable, FitTable
from tracer.scene.scene import Scene
from tracer.strategies.ray_map import build_ray_map
from tracer.strategies.sensitivity import TargetPose
from tracer.strategies.trace import trace

SIZE_PX = 1008
BOARD = Chessboard(3.5, 1.4)
SCENES = ("two_spheres_500", "pair_off_axis", "three_spheres_500", "one_sphere_500")
FAULTS = ("ellipsoid", "index", "bent board", "ball off", "lens term", "support", "light")
LAMPS_K = (2850.0, 3500.0, 4500.0, 5700.0, 6300.0)  # of target frames, where nobody tells
SIZES = {  # least and largest of a fault, drawn evenly in the logarithm
    "ellipsoid": (0.01, 0.2),  # mm between the largest radius and the smallest
    "index": (1e-3, 2e-2),
    "bent board": (0.1, 2.0),  # mm over the view
    "ball off": (0.2, 2.0),  # mm
    "lens term": (1.0, 10.0),  # times k2 = 1.5 and p1 = 3e-4
    "support": (24.0, 24.0),  # px, half width of the strip that is hidden: a rod of 2 mm near the board
}
EDGE_PX2, EDGE_NOISE_PX2 = 0.28, 0.015  # variance of the edge spread as corners of rendered frames have it
TAKEN_UP = 0.6  # of a smear's variance in that of a fitted edge, on rendered frames
COLOURS = 6
PULLED = 0.018  # times twist and unevenness of the view, a half window: so much rendered corners are off still
WINDOW, TWIST_PX = 0.42, 1.0  # half window in squares, shortened to so much twist
NODES = 60  # points of the map that are asked, behind glass and beside it


@dataclass(frozen=True)
class Drawn:
    """A fitted lab with the truth about it."""

    fault: str
    size: float
    noise_px: float
    ball: str
    fit: SceneFit
    pixels: np.ndarray  # (M, 2) behind glass
    error_px: np.ndarray  # (M, 2) of the map, corrected px
    sigma_px: np.ndarray  # (M, 2)
    beside: tuple[np.ndarray, np.ndarray, np.ndarray]  # the same three of what is seen directly

    @property
    def cost_px(self) -> float:
        """Root mean square of the map's error behind glass."""
        return float(np.sqrt(np.mean(np.sum(self.error_px**2, axis=1))))


def home_lab(rng: np.random.Generator, seed: int) -> tuple[Scene, Scene, Chessboard]:
    """Nominal scene, true scene and board of a lab like the paper's."""
    nominal = at_size(demo_scene(SCENES[rng.integers(len(SCENES))]), SIZE_PX)
    return nominal, misalign(nominal, 1000 + seed), BOARD


def drawn_lab(
    seed: int,
    fault: str = "",
    noise_px: float | None = None,
    size: float | None = None,
    draw: Callable[[np.random.Generator, int], tuple[Scene, Scene, Chessboard]] = home_lab,
    pulled: float = 0.0,
) -> Drawn:
    """Draw a lab, take its corners, fit it.

    Parameters
    ----------
    seed : int
        Of everything.
    fault : str
        One of FAULTS, or nothing: then the file is right.
    noise_px : float, optional
        Noise of a corner; drawn from 0.003 (clean) to 0.03 if not given.
    size : float, optional
        Of the fault, as in SIZES; drawn if not given.
    draw : callable
        Gives nominal scene, true scene and board of a seed.
    pulled : float
        How far corners lie off where the view bends, in units of PULLED.
    """
    rng = np.random.default_rng((16, seed))
    noise = float(rng.choice([0.003, 0.006, 0.015, 0.03])) if noise_px is None else noise_px
    nominal, truth, board = draw(rng, seed)
    priors = FitTable()
    ball = truth.spheres[rng.integers(len(truth.spheres))].name
    if size is None:
        least, most = SIZES.get(fault, (0.0, 0.0))
        size = least * (most / max(least, 1e-12)) ** np.random.default_rng((17, seed)).uniform()
    shapes: dict[str, np.ndarray] = {}
    hidden: tuple[np.ndarray, float, float] | None = None
    bend = (0.0, 0.0, 0.0)
    if fault == "ellipsoid":
        turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        radii = rng.uniform(-1.0, 1.0, 3)
        radii -= radii.mean()
        shapes[ball] = turn @ np.diag(radii * size / np.ptp(radii)) @ turn.T
    elif fault == "index":
        priors = priors.model_copy(update={"n": 0.0})
        nominal = with_index(nominal, truth, size * float(rng.choice([-1.0, 1.0])))
    elif fault == "bent board":
        half = float(0.5 * truth.camera.sensor_px[0] * grid_of(truth.camera).pitch_mm)
        a, b, c = rng.uniform(-1.0, 1.0, 3)
        sag = size / (0.5 * half**2 * max(abs(a), abs(c)))
        bend = (a * sag, b * sag, c * sag)
    elif fault == "ball off":
        nominal = nominal.with_bodies(truth.bodies)
        truth = lifted(truth, ball, size)
        priors = priors.model_copy(update={"named": {ball: FitNamedTable(centre_mm=0.0)}})
    elif fault == "lens term":
        k2, p1 = 1.5 * size * float(rng.choice([-1.0, 1.0])), 3e-4 * size * float(rng.normal())
        lens = replace(truth.camera.lens, k2=k2, p1=p1)
        truth = truth.with_camera(replace(truth.camera, lens=lens))
    elif fault == "support":
        turn = float(rng.uniform(0.0, np.pi))
        along = np.array([np.cos(turn), np.sin(turn)])
        hidden = along, float(along @ truth.camera.project(np.array(truth.spheres[-1].centre_mm))), size
    room = truth.n_ambient
    lamp = white_led(float(rng.choice(LAMPS_K))) if fault == "light" else None
    if lamp is not None:
        nominal, truth = of_glass(nominal), of_glass(truth)

    def balls_with(index: Callable[[Medium], float]) -> tuple[Ball, ...]:
        return tuple(
            Ball(
                s.centre_mm,
                s.radius_mm,
                index(s.medium) / room,
                shapes.get(s.name, np.zeros((3, 3))),
                next(((core.radius_mm, index(core.medium) / room) for core in s.cores), None),
            )
            for s in truth.spheres
        )

    def as_measured(medium: Medium) -> float:
        return medium.n(truth.wavelength_nm)

    colours: list[tuple[float, Lab]] = []
    if lamp is not None:
        for nm, share in zip(*lamp.colours(COLOURS), strict=True):
            colours.append((share, Lab(truth.camera, balls_with(lambda medium, nm=nm: medium.n(nm)), bend)))

    lock_px = float(rng.uniform(0.0, 0.02))
    frames = []
    for glass in (False, True):
        balls = balls_with(lamp.index if lamp else as_measured) if glass else ()
        scene = truth if glass else truth.with_bodies(())
        lab = Lab(truth.camera, balls, bend)
        frames.append(photographed(scene, lab, board, glass, noise, lock_px, rng, hidden, colours, pulled))
    bench = unknowns_of(nominal, [0.0], priors)
    fit = Adjustment().estimate(bench, bench.start, frames, ())
    if lamp is not None:
        fit = replace(fit, light=light_uncertainty(nominal, None))
    true_lab = Lab(truth.camera, balls_with(as_measured))
    behind, beside = (map_error(fit, truth, true_lab, rng, through) for through in (True, False))
    return Drawn(fault, size, noise, ball, fit, *behind, beside)


def of_glass(scene: Scene) -> Scene:
    """The same scene with balls of a glass that has dispersion."""
    return scene.with_bodies([replace(s, medium=MEDIA["N-BK7"]) for s in scene.spheres])


def with_index(nominal: Scene, truth: Scene, off: float) -> Scene:
    """The nominal scene with the true index, off by so much."""
    by_name = {s.name: s.medium.n(truth.wavelength_nm) for s in truth.spheres}
    return nominal.with_bodies([replace(s, medium=ConstantMedium(by_name[s.name] + off)) for s in nominal.spheres])


def lifted(truth: Scene, ball: str, up_mm: float) -> Scene:
    """The true scene with one ball glued higher, and those above it with it."""
    low = next(s.centre_mm[2] for s in truth.spheres if s.name == ball)
    bodies = []
    for sphere in truth.spheres:
        x, y, z = sphere.centre_mm
        bodies.append(replace(sphere, centre_mm=(x, y, z + up_mm if z >= low else z)))
    return truth.with_bodies(bodies)


def photographed(
    truth: Scene,
    lab: Lab,
    board: Chessboard,
    glass: bool,
    noise_px: float,
    lock_px: float,
    rng: np.random.Generator,
    hidden_px: tuple[np.ndarray, float, float] | None = None,
    colours: Sequence[tuple[float, Lab]] = (),
    pulled: float = 0.0,
) -> MeasuredFrame:
    """Corners as measured in a frame; a support hides a strip: its normal (2,), distance, half width [px].

    Each colour of the light is a lab of its own, with its share.
    """
    shown = expect(truth, TargetPose(), board)
    node = board.corner_mm(shown.index)
    pixel = corners_px(lab, shown.pixel, node)
    way = np.array([" > ".join(names) for names in shown.branches])[shown.branch]
    names, counts = np.unique(way[way != ""], return_counts=True)
    expected = dict(zip(names.tolist(), counts.tolist(), strict=True))
    seen = np.isfinite(pixel[:, 0]) & (shown.rim_px > 6.0) & ~(rng.random(len(pixel)) < 0.02)
    if glass and hidden_px is not None:
        along, offset, half = hidden_px
        seen &= np.abs(pixel @ along - offset) > half
    gone = shown.take(~seen)
    lost = LostCorners(gone.index, gone.pixel, way[~seen], gone.rim_px, gone.axes_px)
    pixel, shown, way = pixel[seen], shown.take(seen), way[seen]
    if pulled:
        pixel = pixel + pulled * pull_px(lab, pixel, shown.axes_px, board.square_mm)
    sigma = noise_px * np.exp(0.3 * rng.normal(size=pixel.shape))
    pixel = pixel + sigma * rng.normal(size=pixel.shape) + lock_px * locked(pixel, shown.axes_px)
    corners = Corners(0, glass, pixel, board.corner_mm(shown.index), whitening(sigma))
    variance = EDGE_PX2 + np.hypot(EDGE_NOISE_PX2, sigma) * rng.spawn(1)[0].normal(size=pixel.shape)
    if colours:
        variance = variance + TAKEN_UP * smear_px2(lab, colours, pixel, shown.axes_px)
    spread = EdgeSpread(variance, np.zeros_like(variance), np.zeros_like(variance))
    name = "glass" if glass else "bare"
    return MeasuredFrame(
        name,
        corners,
        shown.index,
        shown.axes_px,
        way,
        shown.rim_px,
        sigma,
        expected,
        {},
        lost,
        spread,
        bent_px=window_bias(truth, TargetPose(), board, shown, np.full(len(shown), EDGE_PX2**0.5))[1],
    )


def pull_px(lab: Lab, pixel: np.ndarray, axes_px: np.ndarray, square_mm: float) -> np.ndarray:
    """How far corners (N, 2) lie off where the view bends so much that no window is free of it."""
    here, out = shown_mm(lab, pixel)[0], np.zeros_like(pixel)
    length = np.full(len(pixel), WINDOW)
    for _ in range(2):
        twist, out = np.zeros(len(pixel)), np.zeros_like(pixel)
        for axis in range(2):
            arm = length[:, None] * axes_px[:, :, axis]
            a, b = (shown_mm(lab, pixel + sign * arm)[0] for sign in (1.0, -1.0))
            odd = (a - b) / (2.0 * square_mm)
            odd[:, axis] -= length
            twist = np.fmax(twist, np.linalg.norm(np.einsum("nij,nj->ni", axes_px, odd), axis=1))
            out += np.einsum("nij,nj->ni", axes_px, (a + b - 2.0 * here) / (2.0 * square_mm))
        length = length * np.minimum(1.0, (TWIST_PX / np.maximum(twist, 1e-9)) ** (1.0 / 3.0))
    half_px = length * np.linalg.norm(axes_px, axis=1).mean(axis=1)
    return np.nan_to_num((PULLED * twist / half_px)[:, None] * out)


def smear_px2(
    lab: Lab, colours: Sequence[tuple[float, Lab]], pixel: np.ndarray, axes_px: np.ndarray
) -> np.ndarray:
    """Variance (N, 2) of the colours across the edges along the board's +x and +y."""
    step = 1e-3
    sides = [shown_mm(lab, pixel + step * way)[0] - shown_mm(lab, pixel - step * way)[0] for way in np.eye(2)]
    rate = np.stack(sides, axis=2) / (2.0 * step)
    edges = axes_px / np.linalg.norm(axes_px, axis=1, keepdims=True)
    off = np.stack([shown_mm(one, pixel)[0] - shown_mm(lab, pixel)[0] for _, one in colours])
    moved = np.linalg.solve(rate, np.moveaxis(off, 0, 2))  # (N, 2, K)
    across = edges[:, 0, :, None] * moved[:, 1, None] - edges[:, 1, :, None] * moved[:, 0, None]
    share = np.array([part for part, _ in colours])
    return np.nan_to_num(across**2 @ share - (across @ share) ** 2)


def locked(pixel: np.ndarray, axes_px: np.ndarray) -> np.ndarray:
    """Pull (N, 2) towards pixel centres of edges along rows and columns, which fades as they lean."""
    out = np.zeros_like(pixel)
    for axis in range(2):  # u: the edge that runs more along v, and the other way round
        along, across = np.abs(axes_px[:, 1 - axis]), np.abs(axes_px[:, axis])
        edge = np.argmax(along / np.maximum(across, 1e-12), axis=1)
        lean = np.take_along_axis(across, edge[:, None], 1)[:, 0]
        out[:, axis] = -np.sin(2.0 * np.pi * pixel[:, axis]) * np.sinc(0.84 * lean)
    return out


def map_error(
    fit: SceneFit, truth: Scene, lab: Lab, rng: np.random.Generator, behind: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pixels (M, 2) that show nodes behind or beside glass, error and sigma (M, 2) [corrected px] of the map."""
    grid = grid_of(truth.camera)
    coarse = PlaneGrid(grid.origin_mm, 4 * grid.pitch_mm, (grid.shape[0] // 4, grid.shape[1] // 4))
    seen = build_correction_map(truth, build_ray_map(truth), coarse, min_magnification=2.0, max_magnification=64.0)
    pixels = seen.pixel[0][seen.behind_glass if behind else seen.recovered & ~seen.behind_glass]
    pixels = pixels[rng.permutation(len(pixels))[: 2 * NODES]]
    if not len(pixels):
        return pixels, np.zeros((0, 2)), np.zeros((0, 2))
    found = trace(fit.scene, pixels)
    true_mm, through = shown_mm(lab, pixels)
    ways = [name for sphere in truth.spheres for name in (sphere.name, f"{sphere.name} core")]
    order = {name: number for number, name in enumerate(ways, start=1)}
    codes = dict.fromkeys(found.branches, 0)
    for key, branch in found.branches.items():
        for event in branch:
            codes[key] = codes[key] * (len(order) + 1) + order.get(event, 0)
    same = np.array([codes[int(key)] for key in found.rays["key"]]) == through
    chosen = np.flatnonzero(same & found.recovered & np.isfinite(true_mm[:, 0]))[:NODES]
    error = (found.plane_mm - true_mm)[chosen] / grid.pitch_mm
    return pixels[chosen], error, sigma_at(fit, pixels[chosen], behind) / grid.pitch_mm


def chance_of(fit: SceneFit, pixels: np.ndarray, error_px: np.ndarray, behind: bool) -> float:
    """Chance that a lab whose sigma is right errs at least as much; even from 0 to 1 over many labs.

    A lab errs in few independent ways (2 to 10 where corners are many): chi of a single one is 0.4 to 1.6 by
    chance, and says little.  Its distribution follows from the columns of the root of the covariance.
    """
    scene = fit.measured_scene if behind else fit.measured_scene.bare()
    spread = SceneSigma.of(fit).spread(scene, pixels) / grid_of(scene.camera).pitch_mm
    kept = np.isfinite(spread).all(axis=(1, 2)) & np.isfinite(error_px).all(axis=1)
    columns, error = spread[kept].reshape(-1, spread.shape[2]), error_px[kept].ravel()
    sigma = np.linalg.norm(columns, axis=1)
    weights = np.linalg.eigvalsh((columns.T / sigma) @ (columns / sigma[:, None])) / len(error)
    squares = np.random.default_rng(1).standard_normal((20000, len(weights))) ** 2 @ weights
    return float(np.mean(squares >= np.mean((error / sigma) ** 2)))
