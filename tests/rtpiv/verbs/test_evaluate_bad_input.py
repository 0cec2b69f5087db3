"""What people hand to `rtpiv evaluate` by mistake: one sentence with the name, or a count; never silence."""

import json

import cv2
import numpy as np
import pytest
import tifffile

from ground.map_file import save_arrays
from rtpiv.command_line.cli import DONE, USAGE, main
from sim.renderer.patterns import print_particles
from sim.renderer.render import render
from sim.renderer.sensor import Sensor
from tests.correction.small_scenes import small_scene
from tests.loops import loop_over
from tests.slow_cases import slow
from tracer.scene.scene_file import dump_scene, load_scene

SIZE_PX = 224


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    """A pair of the bare view, 12 bit."""
    folder = tmp_path_factory.mktemp("pair")
    scene = small_scene("two_spheres_500", SIZE_PX).with_bodies(())
    (folder / "scene.yaml").write_text(dump_scene(scene))
    sheet = print_particles((180.0, 180.0), scene.camera.focal_px / 500.0, seed=1)
    frames = [
        render(scene, print_, Sensor(), seed=k) for k, print_ in enumerate((sheet, sheet.displace((1.5, 0.8))))
    ]
    return folder / "scene.yaml", frames


def evaluate(tmp_path, scene, frames, *options, write=tifffile.imwrite, ending="tif"):
    paths = [tmp_path / f"{name}.{ending}" for name, _ in zip("ab", frames, strict=False)]
    for path, frame in zip(paths, frames, strict=True):
        write(str(path), frame)
    return main(["evaluate", *map(str, paths), "--scene", str(scene), "-o", str(tmp_path / "out"), *options])


def spoiled(frames, kind):
    a, b = frames
    return {
        "sizes": (a, b[:-2]),
        "smaller than the scene": (a[:100, :100], b[:100, :100]),
        "half numbers": (a.astype(np.float16), b),
        "constant": (a, np.full_like(b, 90)),
        "stack": (np.stack((a, b)), b),
        "one frame": (a,),
        "NaN": (a.astype(np.float32), np.where(a > 1000, np.nan, b).astype(np.float32)),
    }[kind]


SENTENCES = {
    "sizes": "b.tif: is 224 x 222 px, and 224 x 224 px are expected",
    "smaller than the scene": "a.tif: is 100 x 100 px, and 224 x 224 px are expected",
    "half numbers": "a.tif: holds float16; frames are integers of 8 to 64 bits or float32 or float64",
    "constant": "frame B is constant",
    "stack": "a.tif: holds 2 pages; say which",
    "one frame": "give two frames, or one folder",
    "NaN": "such values in all; give frames as acquired",
}


@loop_over("kind", SENTENCES)
def test_what_is_no_pair_is_one_sentence(good, tmp_path, capsys, kind):
    scene, frames = good
    assert evaluate(tmp_path, scene, spoiled(frames, kind)) == USAGE
    error = capsys.readouterr().err
    assert error.startswith("rtpiv evaluate: ")
    assert SENTENCES[kind] in error
    assert len(error.strip().splitlines()) == 1
    assert not (tmp_path / "out" / "vectors.nc").exists()


def test_the_removed_route_is_one_sentence(good, tmp_path, capsys):
    scene, frames = good
    assert evaluate(tmp_path, scene, frames, "--route", "velocity") == USAGE
    assert "the velocity route was removed" in capsys.readouterr().err


@pytest.mark.slow
def test_strangers_are_not_taken_for_a_pair_in_silence(good, tmp_path, capsys):
    scene, frames = good
    strangers = [
        render(load_scene(scene), print_particles((180.0, 180.0), 1.1, seed=k), Sensor(), seed=k + 1)
        for k in (2, 6)
    ]
    assert evaluate(tmp_path, scene, (frames[0], strangers[0])) == USAGE  # of these not one window matches
    assert "no window gave a vector that its own correlation supports; check" in capsys.readouterr().err
    assert evaluate(tmp_path, scene, (frames[0], strangers[1])) == DONE
    said = " ".join(capsys.readouterr().out.split())
    assert "no better than unrelated pictures, so no vector is valid" in said
    assert "check that they are one pair" in (tmp_path / "out" / "report.html").read_text()
    summary = json.loads((tmp_path / "out" / "evaluation.json").read_text())
    assert summary["doubt"]
    assert summary["vectors"]["valid"] == 0


def test_a_pair_of_which_little_is_shared_is_told_what_measures_more(good, tmp_path, capsys):
    scene, (first, second) = good
    other = render(load_scene(scene), print_particles((180.0, 180.0), 1.1, seed=2), Sensor(), seed=3)
    mixed = np.where(np.arange(first.shape[1]) < 96, second, other)
    assert evaluate(tmp_path, scene, (first, mixed)) == DONE
    said = " ".join(capsys.readouterr().out.split())
    assert "% of the vectors were measured" in said
    assert "larger last windows measure more" in said
    assert "check that the frames are one pair" in (tmp_path / "out" / "report.html").read_text()


@pytest.mark.parametrize("kind", ["8 bit png", slow("16 bit left-aligned")])
def test_other_depths_give_the_same_vectors(good, tmp_path, kind):
    scene, frames = good
    changed = [(frame >> 4).astype(np.uint8) for frame in frames]
    how = {"write": cv2.imwrite, "ending": "png"} if kind.endswith("png") else {}
    if kind.startswith("16"):
        changed = [frame << 4 for frame in frames]
    assert evaluate(tmp_path, scene, changed, "--shift-mm", "1.5", "0.8", **how) == DONE
    summary = json.loads((tmp_path / "out" / "evaluation.json").read_text())
    assert not summary["doubt"]
    shift = summary["shift"]
    assert np.abs(shift["regions"]["seen directly"]["bias_px"]).max() < 0.02
    text = (tmp_path / "out" / "report.html").read_text()
    assert {"8": "255", "1": "65535"}[kind[0]] in text


def test_a_fit_that_cannot_be_used_is_said_and_left_out(good, tmp_path, capsys):
    """Damaged, or of another scene: vectors are measured without the map's uncertainty, and it is said."""
    scene, frames = good
    (tmp_path / "scene.yaml").write_text(scene.read_text())
    (tmp_path / "fit.npz").write_bytes(b"PK nonsense")
    assert evaluate(tmp_path, tmp_path / "scene.yaml", frames, "--no-pictures") == DONE
    assert "no map uncertainty" in capsys.readouterr().out
    summary = json.loads((tmp_path / "out" / "evaluation.json").read_text())
    assert "is damaged" in summary["no_map_sigma"]
    header = {"names": [], "scene_hash": "0123456789abcdef", "nominal_hash": "0" * 16, "history": []}
    save_arrays(tmp_path / "fit.npz", "scene fit", header, {"scene_root": np.eye(14)})
    assert evaluate(tmp_path, tmp_path / "scene.yaml", frames, "--no-pictures") == DONE
    assert "the fit belongs to scene 0123456789abcdef" in " ".join(capsys.readouterr().out.split())


def test_one_picture_twice_is_said(good, tmp_path, capsys):
    scene, (frame, _) = good
    assert evaluate(tmp_path, scene, (frame, frame), "--no-pictures") == DONE
    assert "frames A and B are the same picture" in " ".join(capsys.readouterr().out.split())
    assert json.loads((tmp_path / "out" / "evaluation.json").read_text())["doubt"]


@pytest.mark.parametrize("verb", ["evaluate", "mean"])
def test_a_call_that_is_refused_leaves_no_new_folder(tmp_path, verb):
    frames = tmp_path / "day"
    frames.mkdir()
    for number, rows in enumerate((96, 64)):
        tifffile.imwrite(frames / f"im{number}.tif", np.full((rows, 96), 40 + number, np.uint16))
    named = sorted(map(str, frames.iterdir())) if verb == "evaluate" else [str(frames)]
    out = tmp_path / "out"
    words = ["--mm-per-px", "0.05", "-o", str(out), *(["--mask", "none.png"] if verb == "mean" else [])]
    assert main([verb, *named, *words]) == USAGE
    assert not out.exists()
    out.mkdir()
    (out / "notes.txt").write_text("mine")
    assert main([verb, *named, *words]) == USAGE
    assert (out / "notes.txt").exists()
