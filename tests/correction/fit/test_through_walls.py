"""Balls behind a window, fitted from target frames of the renderer's own optics; walls are held."""

from pathlib import Path

import numpy as np
import pytest

from rtpiv.command_line.cli import DONE, main
from sim.demo.frames import make_frames
from tracer.scene.scene_file import load_scene
from tracer.strategies.trace import trace

EXAMPLES = Path(__file__).resolve().parents[3] / "examples"


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_balls_in_a_furnace_are_fitted_through_its_window(tmp_path: Path) -> None:
    """Rms of the map inside r < 0.75 R below 0.02 px, centres within 10 um, from a start 0.2 mm off."""
    made = make_frames(load_scene(EXAMPLES / "furnace_window.yaml"), 1008, 5, tmp_path / "frames")
    fit, nominal = tmp_path / "fit", tmp_path / "frames" / "scene.yaml"
    words = ["calibrate", str(made.folder), "--scene", str(nominal), "-o", str(fit), "--no-pictures"]
    assert main(words) == DONE
    found = load_scene(fit / "scene.yaml")
    for ball, truth in zip(found.spheres, made.truth.spheres, strict=True):
        assert np.linalg.norm(np.array(ball.centre_mm) - truth.centre_mm) < 0.01
    pixels = np.stack(np.meshgrid(*[np.arange(8.0, 1000.0, 12.0)] * 2), axis=-1).reshape(-1, 2)
    seen, true = trace(found, pixels), trace(made.truth, pixels)
    lower = made.truth.spheres[-1]
    middle = np.linalg.norm(true.plane_mm - lower.centre_mm[:2], axis=-1) < 0.75 * lower.radius_mm
    same = seen.recovered & true.recovered & (seen.rays["key"] == true.rays["key"]) & middle
    px_per_mm = found.camera.focal_px / float(np.linalg.norm(found.camera.position_mm))
    error_px = px_per_mm * (seen.plane_mm - true.plane_mm)[same]
    assert same.sum() > 3000
    assert np.sqrt(np.mean(error_px**2)) < 0.02
