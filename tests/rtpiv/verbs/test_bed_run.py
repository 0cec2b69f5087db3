"""Beds from `init` to their mean flow: calibrated with the board behind them, in bent light."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
import yaml
from numpy.typing import NDArray

from piv.files.vector_file import read_vectors
from rtpiv.command_line.cli import DONE, main
from tracer.scene.scene_file import load_scene

FLOW_M_S = np.array((0.8, -0.4))
BED = "--arrangement bcc --layers 3 --plane 1 --sensor-px 640 512 --pixel-pitch-um 9.6 --lens-mm 25 --yes"
TUBE = "--arrangement tube --layers 5 --ball-mm 15 --glass N-BK7 --yes"
ON_THE_BENCH = "--simulate --home --operator me"
PAIRS = 20


def edit(path: Path, *changes: tuple[str, str]) -> None:
    """Put other words for those that a pattern finds, once each."""
    text = path.read_text()
    for pattern, instead in changes:
        text, count = re.subn(pattern, instead, text, count=1)
        assert count == 1, (path, pattern)
    path.write_text(text)


def run_bed(folder: Path, bed: str) -> None:
    """Acquire, calibrate and evaluate a simulated bed in the working folder; a tube without aperture."""
    assert main(["init", ".", *bed.split()]) == DONE
    aperture = r"  aperture: {f_mm: 25, f_number: 16, focus_mm: 460}\n  seed: "
    uniform = "field: uniform, parameters: {velocity_mm_s: [800.0, -400.0, 0.0]}"
    if bed != TUBE:
        for name in ("bench.yaml", "bench-flow.yaml"):
            edit(folder / name, (r"  seed: ", aperture))
        edit(
            folder / "scene.yaml",
            (r"  f_mm: 25 ", "  f_number: 16\n  focus_mm: 460\n  f_mm: 25 "),
            # The sheet of the bench lies where the scene has it: its sigma would hide errors that others cover
            (r"  sigma_mm: 0.3\n", "  sigma_mm: 0.01\n  tilt_sigma_deg: 0.01\n"),
        )
    edit(folder / "bench-flow.yaml", (r"field: between_balls, parameters: {.*?}", uniform))
    edit(folder / "plan-flow.yaml", (r"pairs: \d+ ", f"pairs: {PAIRS} "))
    target = f"plan-target.yaml --bench bench.yaml {ON_THE_BENCH} --no-correct"
    assert main(["acquire", *target.split()]) == DONE
    (seen,) = folder.glob("runs/*plan-target")
    assert main(["calibrate", str(seen), "-o", "bedfit"]) == DONE
    assert main(["acquire", *f"plan-flow.yaml --bench bench-flow.yaml {ON_THE_BENCH}".split()]) == DONE
    (flow,) = folder.glob("runs/*plan-flow")
    how = ["--scene", "bedfit/scene.yaml", "--final-window", "24"]
    assert main(["mean", str(flow), *how]) == DONE


def mean_errors(series: Path) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Errors (N, 2) of a mean against the flow itself, and their stated standard uncertainty [px]."""
    found = read_vectors(series / "mean.nc")
    to_px = float(found.attributes["px_per_mm"]) * 1e3 * float(found.attributes["delta_t"])
    mean, sigma = (
        np.stack([found.fields[name + axis][0] for axis in "uv"], axis=-1) for name in ("", "total_sigma_")
    )
    known = np.isfinite(mean).all(axis=-1) & np.isfinite(sigma).all(axis=-1)
    return (mean[known] - FLOW_M_S) * to_px, sigma[known] * to_px


def centre_errors(fitted: Path, seen: Path) -> NDArray[np.float64]:
    """Errors (B, 3) [mm] of the centres of all balls, where the play of the axes had them in the run `seen`."""
    true = yaml.safe_load((seen / "truth.yaml").read_text())["bodies"]
    true = [body for body in true if body["kind"] == "sphere"]
    lines = [json.loads(line) for line in (seen / "steps.jsonl").read_text().splitlines()]
    stood = [one["true_mm"] for one in lines if one.get("tag", "").startswith("target_glass")]
    play_mm = np.mean([[place[f"glass_{axis}"] for axis in "xyz"] for place in stood], axis=0)
    found = {ball.name: ball.centre_mm for ball in load_scene(fitted).spheres}
    return np.array([np.subtract(found[ball["name"]], ball["centre_mm"]) for ball in true]) - play_mm


def measure_bed(folder: Path) -> tuple[NDArray[np.float64], ...]:
    """Errors (N, 2) [px] of a mean flow, their stated sigma (N, 2), and rms (3,) [mm] of the centres."""
    (seen,), (flow,) = (tuple(folder.glob(f"runs/*{plan}")) for plan in ("plan-target", "plan-flow"))
    off, sigma = mean_errors(flow / "series")
    centres = centre_errors(folder / "bedfit" / "scene.yaml", seen)
    rms = np.sqrt(np.mean(centres**2, axis=0))
    print(len(off), np.median(np.abs(off)), np.sqrt(np.mean(off**2)), np.mean(np.abs(off) < sigma), rms)
    return off, sigma, rms


def judge_bed(folder: Path) -> None:
    """Hold a calibrated bed and its mean flow to the truth."""
    off, sigma, rms = measure_bed(folder)
    assert len(off) > 500
    assert np.median(np.abs(off)) < 0.015
    # Where hardly a particle is lit beside a ball, vectors of pairs scatter by pixels, and the mean says so.
    known = sigma.max(axis=1) < 0.1
    assert known.mean() > 0.98
    assert np.sqrt(np.mean(off[known] ** 2)) < 0.03
    assert np.abs(off[~known] / sigma[~known]).max(initial=0.0) < 3.0
    assert 0.63 < np.mean(np.abs(off) < sigma) < 0.76
    assert rms[:2].max() < 0.015
    assert rms[2] < 0.035
    (series,) = folder.glob("runs/*plan-flow/series")
    fields = read_vectors(series / "mean.nc").fields
    height_mm = fields["light_z"][0][np.isfinite(fields["u"][0])]
    assert np.isfinite(height_mm).mean() > 0.98
    assert 0.1 < np.nanmax(np.abs(height_mm)) < 4.0


@pytest.mark.slow
def test_a_bed_from_init_to_its_mean_flow(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    run_bed(tmp_path, BED)
    said = " ".join(capsys.readouterr().out.split())
    share = re.search(r"inside a bed: (\d+) % of the gaps is lit and seen", said)
    assert share is not None
    assert int(share[1]) >= 60
    judge_bed(tmp_path)


def judge_tube(folder: Path) -> None:
    """Hold a calibrated tube and its mean flow to the truth: a few nodes behind balls are far off, and say so."""
    off, sigma, rms = measure_bed(folder)
    assert len(off) > 500
    assert np.median(np.abs(off)) < 0.015
    assert np.sqrt(np.mean(off**2)) < 0.08
    assert np.mean(np.abs(off) < sigma) > 0.63
    assert rms[:2].max() < 0.01
    assert rms[2] < 0.02


@pytest.mark.slow  # its balls followed the tube's edge: correction/fit/test_silhouettes.py
def test_a_packed_tube_from_init_to_its_mean_flow(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    run_bed(tmp_path, TUBE)
    judge_tube(tmp_path)
