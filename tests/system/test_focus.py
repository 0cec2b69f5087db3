"""A focus scan by the command line on the simulated bench: R6 of the paper, behind two balls through f/2.8."""

import json

import pytest

from daq.cli import DONE, main
from tests.daq.small_bench import write_bench

pytest.importorskip("harvesters", reason="the camera needs harvesters (extra rtpiv[camera])")

PLAN = """experiment: focus
z_mm: [{places}]
f_number: 22.0
pixel_pitch_um: {pitch_um}
"""
LENS = "aperture: {{f_mm: 60.0, f_number: 2.8, focus_mm: 500.0}}\nsamples: {samples}\nis_misaligned: false"


def scanned(folder, size_px, places, samples):
    write_bench(folder, size_px, LENS.format(samples=samples))
    pitch_um = 11.0 * 2016 / size_px
    (folder / "plan.yaml").write_text(PLAN.format(places=", ".join(f"{z:.1f}" for z in places), pitch_um=pitch_um))
    acquire = [
        "acquire",
        str(folder / "plan.yaml"),
        "--bench",
        str(folder / "bench.yaml"),
        "-o",
        str(folder / "runs"),
    ]
    assert main([*acquire, "--simulate", "--home", "--no-correct"]) == DONE
    (run,) = (folder / "runs").iterdir()
    assert main(["focus", str(run)]) == DONE
    assert (run / "focus.html").stat().st_size > 5000
    return json.loads((run / "focus.json").read_text())


@pytest.mark.slow
def test_two_balls_need_125_mm_and_a_smaller_aperture_than_planned(tmp_path):
    places = [-12.0, -6.0, -2.0, 2.0, 6.0, 12.0, 108.0, 114.0, 120.0, 126.0, 132.0, 138.0]
    found = scanned(tmp_path, 800, places, 8)
    best = found["best"]
    assert best["beside"]["z_mm"] == pytest.approx(0.0, abs=1.0)
    assert best["far+near: centre"]["z_mm"] - best["beside"]["z_mm"] == pytest.approx(124.7, abs=3.0)
    assert found["depth_mm"] == pytest.approx(83.3, rel=0.05)
    assert found["needed_f_number"] == pytest.approx(27.0, abs=0.6)


def test_a_scan_beside_the_glass_finds_the_plane(tmp_path):
    found = scanned(tmp_path, 160, [-90.0, -60.0, -30.0, 0.0, 30.0, 60.0, 90.0], 6)
    assert found["best"]["beside"]["z_mm"] == pytest.approx(0.0, abs=6.0)
