"""`rtpiv calibrate` from a folder of frames to a fitted scene that `rtpiv correct` reads."""

import json
from pathlib import Path

import pytest

from correction.fit.map_sigma import MapSigma
from correction.frame_file import write_frame
from daq.cli import main
from ground.map_file import load_arrays
from tests.correction.fit.benches import SQUARE_MM, bench
from tracer.scene_file import dump_scene, load_scene


def folder_of(name: str, seed: int, path: Path, kinds: tuple[str, ...] = ("clear", "glass")) -> Path:
    made = bench(name, seed)
    for frame in made.frames:
        kind = "glass" if frame.glass else "clear"
        if kind in kinds:
            write_frame(path / f"target_{kind}.tif", frame.image, 1.0, {})
    (path / "scene.yaml").write_text(dump_scene(made.nominal))
    return path


def arguments(folder: Path, out: Path) -> list[str]:
    board = ["--square-mm", str(SQUARE_MM), "--disc-mm", str(0.4 * SQUARE_MM)]
    return ["calibrate", str(folder), "--scene", str(folder / "scene.yaml"), "-o", str(out), *board]


def test_folder_becomes_a_fitted_scene_with_its_uncertainty_and_report(tmp_path, capsys):
    folder = folder_of("two_spheres_500", 6, tmp_path)
    assert main(arguments(folder, tmp_path / "out")) == 0
    out, err = capsys.readouterr()
    truth, fitted = bench("two_spheres_500", 6).truth, load_scene(tmp_path / "out" / "scene.yaml")
    for found, true in zip(fitted.spheres, truth.spheres, strict=True):
        assert found.centre_mm[:2] == pytest.approx(true.centre_mm[:2], abs=0.02)
    summary = json.loads((tmp_path / "out" / "calibration.json").read_text())
    assert summary["scene_hash"] == fitted.content_hash()
    page = (tmp_path / "out" / "calibration.html").read_text()
    assert "is the model right?" in page
    assert "The model is right as far as the corners tell" in page
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
        max(region["rms_px"]) for regions in (before, after) for region in regions if region["region"] == "inside"
    ]
    assert inside[0] > 5.0 * inside[1]
    grid = summary["table2_corrected_minus_grid_px"]
    assert (
        max(grid["fitted"]["behind glass"]["rms_px"])
        <= 0.10
        < max(grid["nominal glass"]["behind glass"]["rms_px"])
    )
    assert "nearly one unknown" in " ".join(out.split())
    assert "camera on target_clear" in err


@pytest.mark.parametrize(
    ("kinds", "sentence"),
    [
        ((), "holds no frame of the target; name them target_clear.tif"),
        (("glass",), "a frame of the bare target at z = 0 is needed"),
        (("clear",), "no frame shows the target through them"),
    ],
)
def test_missing_views_are_one_sentence_and_exit_code_2(tmp_path, capsys, kinds, sentence):
    folder = folder_of("two_spheres_500", 6, tmp_path, kinds)
    assert main(arguments(folder, tmp_path / "out")) == 2
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("rtpiv calibrate:")]
    assert len(lines) == 1
    assert sentence in lines[0]
    assert not (tmp_path / "out").exists()


def test_a_folder_that_is_no_run_needs_a_scene(tmp_path, capsys):
    folder = folder_of("two_spheres_500", 6, tmp_path)
    assert main(["calibrate", str(folder), "-o", str(tmp_path / "out")]) == 2
    assert "give the nominal one with --scene" in " ".join(capsys.readouterr().err.split())
