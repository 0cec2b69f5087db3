"""Boxes, cuvettes and prisms found from rendered frames of a board, with the scene file off by its priors."""

from dataclasses import replace

import numpy as np
import pytest

from correction.fit.scene_fit import fit_scene
from correction.fitted.map_sigma import sigma_at
from correction.grid import grid_of
from correction.target import Chessboard
from sim.demo.scenes import at_size, demo_scene, misalign
from tests.correction.fit.benches import map_error_px, photograph
from tests.tracer.test_blocks import WATER
from tracer.bodies import Block, Box, Prism
from tracer.bodies.block import UNTURNED, rectangle, rotate_axes
from tracer.media import MEDIA
from tracer.strategies.branches import DIRECT
from tracer.strategies.trace import trace

SIZE_PX, SQUARE_MM, NM = 700, 3.5, 532.0
GLASS = MEDIA["borosilicate"]
TILT = rotate_axes(UNTURNED, (0.05, 0.2, 0.1))
BASE = at_size(demo_scene("two_spheres_500"), SIZE_PX)
OFF = {"place_mm": 0.5, "tilt_deg": float(np.deg2rad(0.5)), "thickness_mm": 0.05, "n": 0.002}
BLOCKS = {
    "box": Box("box", rectangle(60.0, 50.0), 40.0, GLASS, (4.0, -3.0, 45.0), TILT),
    "cuvette": Box(
        "cuvette", rectangle(60.0, 50.0), 30.0, GLASS, (4.0, -3.0, 45.0), TILT, 2.5, WATER, carried_by="glass"
    ),
    "prism": Prism("prism", ((-25.0, -20.0), (25.0, -20.0), (-25.0, -8.0)), 50.0, GLASS, (0.0, 10.0, 40.0), TILT),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize(("kind", "seed"), [("box", 1), ("cuvette", 2), ("prism", 3)])
def test_a_block_is_found_by_the_board_behind_and_beside_it(kind: str, seed: int) -> None:
    """Map <= 0.05 px rms beside it and through the faces that show corners, the rest within its sigma."""
    block: Block = BLOCKS[kind]
    numbers, rng = block.numbers(NM), np.random.default_rng(seed)
    true = [number.value + float(rng.normal()) * OFF[number.known] for number in numbers]
    nominal = replace(BASE, bodies=(block,))
    truth = misalign(nominal, seed).with_bodies([block.with_numbers(true, NM)])
    frames = [
        photograph(truth.bare(), False, 0.0, seed, SQUARE_MM),
        photograph(truth, True, 0.0, seed + 9, SQUARE_MM),
    ]
    fit = fit_scene(nominal, frames, Chessboard(SQUARE_MM, 0.4 * SQUARE_MM))
    u, v = np.meshgrid(np.arange(5.0, 695.0, 10.0), np.arange(5.0, 695.0, 10.0))
    pixels = np.stack((u.ravel(), v.ravel()), axis=-1)
    rays, error_px = trace(truth, pixels), map_error_px(fit.scene, truth, pixels, grid_of(truth.camera))
    pitch_mm, keys, seen = grid_of(truth.camera).pitch_mm, rays.rays["key"], np.isfinite(error_px).all(axis=1)
    direct, through = rays.recovered & (keys == DIRECT), rays.recovered & (keys != DIRECT)
    counts = {key: int((through & (keys == key)).sum()) for key in rays.branches}
    main = through & (keys == max(counts, key=lambda key: counts[key]))
    for what, chosen in (("beside", direct), ("through", main)):
        rms = np.sqrt(np.mean(error_px[chosen & seen] ** 2))
        print(kind, seed, what, f"{rms:.4f} px, {seen[chosen].mean():.3f} of {chosen.sum()} on their way")
        assert rms < 0.05
    if kind == "box":  # its outline says where its side faces are
        assert np.abs(error_px[through & seen]).max() < 0.1
    # ways by faces that show no corner, such as mirror images, are as far off as their sigma says
    off = np.abs(error_px[through & seen]) / (sigma_at(fit, pixels[through & seen], True) / pitch_mm)
    print(kind, seed, f"within 4 sigma {np.mean(off < 4.0):.3f}")
    assert np.mean(off < 4.0) > 0.95
    for number, value in zip(numbers, true, strict=True):
        at = fit.names.index(f"{block.name}.{number.name}")
        assert abs(fit.values[at] - value) < 4.0 * fit.sigmas[at], number.name
