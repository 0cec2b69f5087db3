"""The second test of the paper in beds as people have them: window, tube, liquid, many balls."""

from pathlib import Path

import numpy as np
import pytest
import tifffile

from rtpiv.analysis.pairs.evaluation import PairDetails
from rtpiv.verbs.evaluate import EvaluationOutput, evaluate
from sim.renderer.patterns import print_particles
from sim.renderer.render import render
from sim.renderer.sensor import Sensor
from tracer.scene.scene_file import load_scene

EXAMPLES = Path(__file__).resolve().parents[3] / "examples"
SHIFT_PX = 4.0


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize(
    ("name", "least"),
    [("furnace_window", 2000), ("column_in_tube", 200), ("matched_bed", 1500), ("body_centred_bed", 200)],
)
def test_shift_in_beds(name: str, least: int, tmp_path: Path) -> None:
    """Known geometry, frames by the renderer's optics: std <= 0.05 px inside r < 0.75 R, bias <= 0.02 px."""
    path = EXAMPLES / f"{name}.yaml"
    scene = load_scene(path)
    px_per_mm = scene.camera.focal_px / float(np.linalg.norm(scene.camera.position_mm))
    width, height = (1.5 * size / px_per_mm for size in scene.camera.sensor_px)
    sheet = print_particles((width, height), px_per_mm, seed=3)
    step = SHIFT_PX / px_per_mm / float(np.sqrt(2.0))
    pair = [tmp_path / "a.tif", tmp_path / "b.tif"]
    for seed, (file, pattern) in enumerate(zip(pair, (sheet, sheet.displace((step, step))), strict=True)):
        tifffile.imwrite(file, render(scene, pattern, Sensor(), samples=4, seed=50 + seed))
    details, output = PairDetails((step, step)), EvaluationOutput(pictures=False)
    (found,) = evaluate(pair, tmp_path / "out", path, details=details, output=output).details
    assert found.shift is not None
    middle = found.shift.regions["behind glass, r < 0.75 R"]
    assert middle.count > least
    assert max(middle.std_px) <= 0.05
    assert max(np.abs(middle.bias_px)) <= 0.02
