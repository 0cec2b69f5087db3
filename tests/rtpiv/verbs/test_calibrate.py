"""`rtpiv calibrate` from a folder of frames to a fitted scene that `rtpiv correct` reads."""

import json
import re
from pathlib import Path

import pytest

from correction.fitted.map_sigma import MapSigma
from daq.bench.bench_file import load_bench
from daq.plans.plan import load_plan
from daq.runner.session import Request, begin
from ground.map_file import load_arrays
from piv.files.frame_file import write_frame
from rtpiv.command_line.cli import main
from rtpiv.verbs.calibrate import nominal_scene
from tests.correction.fit.benches import bench
from tests.daq.small_bench import TARGET, write_bench
from tracer.scene.scene_file import dump_scene, load_priors, load_scene

MADE = "two_spheres_500", 6, (), (), 714


def folder_of(path: Path, kinds: tuple[str, ...] = ("clear", "glass")) -> Path:
    made = bench(*MADE)
    for frame in made.frames:
        kind = "glass" if frame.glass else "clear"
        if kind in kinds:
            write_frame(path / f"target_{kind}.tif", frame.image, 1.0, {})
    (path / "scene.yaml").write_text(dump_scene(made.nominal))
    return path


def arguments(folder: Path, out: Path) -> list[str]:
    board = ["--square-mm", str(bench(*MADE).board.square_mm), "--disc-mm", str(bench(*MADE).board.disc_mm)]
    return ["calibrate", str(folder), "--scene", str(folder / "scene.yaml"), "-o", str(out), *board]


@pytest.mark.draws
def test_folder_becomes_a_fitted_scene_with_its_uncertainty_and_report(tmp_path, capsys):
    folder = folder_of(tmp_path)
    assert main(arguments(folder, tmp_path / "out")) == 0
    out, err = capsys.readouterr()
    truth, fitted = bench(*MADE).truth, load_scene(tmp_path / "out" / "scene.yaml")
    for found, true in zip(fitted.spheres, truth.spheres, strict=True):
        assert found.centre_mm[:2] == pytest.approx(true.centre_mm[:2], abs=0.02)
    summary = json.loads((tmp_path / "out" / "calibration.json").read_text())
    assert summary["scene_hash"] == fitted.content_hash()
    page = (tmp_path / "out" / "calibration.html").read_text()
    heads = (
        "seen through glass",
        "The model is right within the accuracy of the corners",
        "<i>corrected</i>",
        "<h2>",
    )
    assert sorted(map(page.index, heads)) == list(map(page.index, heads))  # the first screen, in this order
    header, arrays = load_arrays(tmp_path / "out" / "fit.npz", "scene fit")
    assert arrays["covariance"].shape == (len(header["names"]),) * 2
    number = header["names"].index("sphere1.x")
    assert arrays["covariance"][number, number] == pytest.approx(summary["numbers"]["sphere1.x"]["sigma"] ** 2)
    assert MapSigma.load(tmp_path / "out" / "map_sigma.npz").scene_hash == fitted.content_hash()
    assert (tmp_path / "out" / "residuals.png").stat().st_size > 10_000
    assert (tmp_path / "out" / "map_sigma.png").stat().st_size > 10_000
    assert (tmp_path / "out" / "convergence.png").stat().st_size > 10_000
    assert summary["numbers"]["camera.rx"]["unit"] == "deg"
    before = summary["table2_computed_minus_acquired_px"]["nominal glass"]
    after = summary["table2_computed_minus_acquired_px"]["fitted"]
    inside = [
        max(region["rms_px"])
        for regions in (before, after)
        for region in regions
        if region["region"] == "behind glass, off the rims"
    ]
    assert inside[0] > 5.0 * inside[1]
    grid = summary["table2_corrected_minus_grid_px"]
    assert (
        max(grid["fitted"]["behind glass"]["rms_px"])
        <= 0.10
        < max(grid["nominal glass"]["behind glass"]["rms_px"])
    )
    said = " ".join(out.split())
    assert "strongly correlated" in said  # the scale of a print that was not measured, and what is as large as it
    assert "measure its bars (measured_mm in board.yaml, then --board)" in said
    assert not re.search(r"print\.stretch_[^|]*add bare target frames", said)
    assert any("strongly correlated" in each for each in summary["weak"])
    assert "saddles" not in err
    assert "camera on target_clear" in err


@pytest.mark.parametrize(
    ("kinds", "sentence"),
    [
        ((), "holds no frame of the target; name them target_clear.tif"),
        (("glass",), "a frame of the bare target at z = 0 is needed"),
    ],
)
def test_missing_views_are_one_sentence_and_exit_code_2(tmp_path, capsys, kinds, sentence):
    folder = folder_of(tmp_path, kinds)
    assert main(arguments(folder, tmp_path / "out")) == 2
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("rtpiv calibrate:")]
    assert len(lines) == 1
    assert sentence in lines[0]
    assert not (tmp_path / "out").exists()


def test_a_folder_that_is_no_run_needs_a_scene(tmp_path, capsys):
    folder = folder_of(tmp_path)
    assert main(["calibrate", str(folder), "-o", str(tmp_path / "out")]) == 2
    assert "give the nominal one with --scene" in " ".join(capsys.readouterr().err.split())


def test_a_run_is_calibrated_by_what_the_scene_file_of_its_bench_lets_change(tmp_path):
    path = write_bench(tmp_path)
    with (tmp_path / "scene.yaml").open("a") as file:
        file.write("fit: {light: {source: laser}, n: 0.001}\n")
    (tmp_path / "plan.yaml").write_text(TARGET)
    bench = load_bench(path)
    plan = load_plan(tmp_path / "plan.yaml", bench)
    run = begin(Request(path, plan.path, correct=False), bench, plan, tmp_path / "runs").path
    scene, priors = nominal_scene(run, None)
    assert scene.content_hash() == bench.scene.content_hash()
    assert priors == load_priors(tmp_path / "scene.yaml")
    assert priors.light is not None
