"""A whole campaign where nothing has a motor: target, calibrate, shift, report, by a hand that reads to 0.01 mm.

The hand's eye is 10 um off each time, and what it types is a whole number of 10 um: 10.4 um together, as the bench
file says.  Its errors are drawn by the simulated hand and told to nobody; they are judged here by where the
carriages truly stood, and by the vectors.
"""

import json
import math

import numpy as np
import pytest
import yaml

from daq.runs.displacement import read_displacements
from daq.runs.run_folder import RunFolder
from rtpiv.verbs.acquire import LiveFrames, acquire
from rtpiv.verbs.calibrate import calibrate
from rtpiv.verbs.report import report
from tests.daq.hand_bench import EXAMPLES, write_hand_bench

pytestmark = pytest.mark.slow
SIDE_PX, PITCH_UM = 504, 22.0
READS_UM, DIVISION_UM = 10.0, 10.0
READING_UM = math.hypot(READS_UM, DIVISION_UM / math.sqrt(12.0))
SHIFT = """experiment: shift
views: [glass]
displacements:
  - {along: [1.0, 1.0, 0.0], mm: 1.3}
  - {along: [1.0, -1.0, 0.0], mm: 0.9}
repeats: 4
"""


def bench_of_hands(folder, seed):
    hand = {"reads_um": READS_UM, "division_um": DIVISION_UM}
    bench, plan = write_hand_bench(folder, SIDE_PX, SHIFT, hand=hand, seed=seed)
    scene = folder / "scene.yaml"
    text = scene.read_text().replace("pixel_pitch_um: 44.0", f"pixel_pitch_um: {PITCH_UM}")
    scene.write_text("".join(line for line in text.splitlines(keepends=True) if "name: far" not in line))
    tree = yaml.safe_load(bench.read_text())
    tree["simulation"]["samples"] = 4
    for name, axis in tree["stages"]["axes"].items():
        if name.startswith("target"):
            axis["reading_um"] = READING_UM
    bench.write_text(yaml.safe_dump(tree, sort_keys=False))
    return bench, plan


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    """What the run says was moved, what the report found of each pair, and the text of its page."""
    place = tmp_path_factory.mktemp("by_hand")
    bench, plan = bench_of_hands(place, 7)
    raw = LiveFrames(correct=False)
    target = acquire(EXAMPLES / "plan-target-by-hand.yaml", bench, place / "runs", True, home=True, frames=raw)
    calibrate(target, out=place / "fit", pictures=False)
    moved = acquire(plan, bench, place / "runs", True, home=True, frames=raw)
    page = report(moved, place / "report", place / "fit" / "scene.yaml")
    entries = read_displacements(RunFolder.open(moved))
    found = {
        entry["tag"]: json.loads((place / "report" / entry["tag"] / "evaluation.json").read_text())["shift"]
        for entry in entries
    }
    steps = [line for line in RunFolder.open(moved).entries() if line["kind"] == "step"]
    return entries, found, steps, page.read_text(encoding="utf-8")


def test_the_sigma_of_the_hand_is_in_the_journal_and_in_every_way(campaign):
    entries, _, steps, page = campaign
    assert all(step["reading_um"]["target_x"] == pytest.approx(READING_UM) for step in steps)
    way_mm = math.sqrt(2.0) * READING_UM * 1e-3
    assert all(entry["sigma_mm"] == pytest.approx((way_mm, way_mm, 0.0)) for entry in entries)
    assert "sigma of measured, as read by hand" in page
    assert f"{way_mm:.4f}, {way_mm:.4f}, 0.0000" in page


def test_vectors_see_where_the_target_truly_went(campaign):
    """To 0.02 px: what is left of the errors is the hand's, and no fault of map or correlation."""
    entries, found, *_ = campaign
    for entry in entries:
        shift = found[entry["tag"]]
        per_mm = abs(shift["shift_px"][0] / entry["measured_mm"][0])
        wrong_mm = np.subtract(entry["true_mm"], entry["measured_mm"])[:2] * (1.0, -1.0)
        for region in ("seen directly", "behind glass"):
            assert shift["regions"][region]["bias_px"] == pytest.approx(list(wrong_mm * per_mm), abs=0.02), region


@pytest.mark.parametrize("region", ["seen directly", "behind glass"])
def test_the_total_error_is_as_large_as_its_sigma_says(campaign, region):
    """Both components of eight ways; the chance that an honest sigma fails here is one in some hundred."""
    entries, found, *_ = campaign
    squares = []
    for entry in entries:
        shift = found[entry["tag"]]
        of = shift["regions"][region]
        total = np.square(of["bias_px"]) + np.square(of["std_px"])
        sigma = np.square(of["sigma_px"]) + 2.0 * np.square(shift["stage_px"])
        squares += list(total / sigma)
    assert len(squares) == 16
    assert 0.6 < math.sqrt(np.mean(squares)) < 1.45
