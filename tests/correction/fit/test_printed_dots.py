"""A map by a board whose lines a printer has moved to whole dots is as far off as it says."""

from dataclasses import dataclass, field

import numpy as np
import pytest

from correction.fit.scene_fit import fit_scene
from correction.fit.seen.measurement import TargetFrame
from correction.fitted.map_sigma import sigma_at
from correction.grid import grid_of
from correction.target import Chessboard
from correction.target.codes import with_codes
from sim.demo.scenes import at_size, demo_scene, misalign
from sim.renderer.patterns import CodedBoard, Pose
from sim.renderer.render import render
from sim.renderer.sensor import Sensor
from tests.correction.fit.benches import errors_behind, map_error_px
from tracer.board import Codes

SIZE_PX, SQUARE_MM, SEEDS, HEIGHTS_MM = 720, 5.0, (3, 4), (0.0, -10.0, -20.0)
CODES = Codes("DICT_4X4_1000", 0.7)
BOARD = {"squares": (37, 37), "origin_corner": (18, 18), "discs": ()}
DOT_MM = 25.4 / 600.0


@dataclass(frozen=True)
class OfDots:
    """A board on paper, each of its lines on the nearest dot of the printer, wherever its dots begin."""

    paper: CodedBoard
    phase: float
    pose: Pose = field(default_factory=Pose)

    def reflectance(self, points_mm):
        drawn = np.empty_like(points_mm)
        for axis in range(2):
            low, high = self.paper.outer_lines[:, axis]
            lines = np.arange(low, high + 1) * self.paper.square_mm
            printed = (np.rint(lines / DOT_MM + self.phase) - self.phase) * DOT_MM
            drawn[:, axis] = np.interp(points_mm[:, axis], printed, lines)
        return self.paper.reflectance(drawn)


def photographed(truth, seed):
    """Frames of the print in three heights, bare and with the ball."""
    paper, frames = CodedBoard(SQUARE_MM, codes=CODES, **BOARD), []
    phase = np.random.default_rng(seed).random()
    for glass in (False, True):
        scene = truth if glass else truth.with_bodies(())
        for height in HEIGHTS_MM:
            sheet = OfDots(paper, phase, Pose((0.0, 0.0, height)))
            image = render(scene, sheet, Sensor(), samples=3, seed=100 * seed + len(frames))
            frames.append(TargetFrame(f"{glass} {height:g}", image, glass, height))
    return frames


@pytest.mark.slow
def test_the_map_is_as_far_off_as_its_sigma_says():
    nominal = at_size(demo_scene("one_sphere_500"), SIZE_PX)
    board = with_codes(Chessboard(SQUARE_MM, **BOARD), CODES)
    at = np.stack(np.meshgrid(*2 * (np.arange(20, SIZE_PX - 8, 45),)), -1).reshape(-1, 2).astype(float)
    behind, clear = [], []
    for seed in SEEDS:
        truth = misalign(nominal, seed)
        fit = fit_scene(nominal, photographed(truth, seed), board)
        assert any("lines of the print" in str(step) for step in fit.history)
        behind.append(errors_behind(fit, truth)[:2])
        grid = grid_of(truth.camera)
        off = map_error_px(fit.scene.with_bodies(()), truth.with_bodies(()), at, grid)
        sigma = sigma_at(fit, at, False) / grid.pitch_mm
        clear.append((np.linalg.norm(off, axis=1), np.linalg.norm(sigma, axis=1)))
    ratio = {}
    for name, pairs in (("behind", behind), ("clear", clear)):
        error, sigma = (np.concatenate([pair[k] for pair in pairs]) for k in (0, 1))
        ratio[name] = np.sqrt(np.nanmean(error**2) / np.mean(sigma**2))
    assert 0.8 < ratio["behind"] < 1.25
    assert ratio["clear"] < 1.25  # 0.5: there the model test sees the print as well, and adds what it sees
