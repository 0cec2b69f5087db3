"""`rtpiv evaluate --tracking`: what it writes, says and refuses."""

import json
from dataclasses import replace

import numpy as np
import pytest
import tifffile
from scipy.io import netcdf_file

from rtpiv.analysis.pairs.evaluation import PairDetails
from rtpiv.analysis.report.pair_folder import write_pair, write_pair_page
from rtpiv.command_line.cli import DONE, USAGE, main
from rtpiv.verbs.evaluate import evaluate
from sim.demo.scenes import at_size, demo_scene
from sim.flow.fields import Flow, Uniform
from sim.flow.images import FlowCamera, render_pairs
from sim.flow.particles import LightSheet, Seeding
from tracer.scene.scene_file import dump_scene

SHIFT_MM = (1.8, 0.9)
BY_HAND = {"seen directly", "behind glass, r < 0.75 R", "behind glass, r > 0.75 R"}


@pytest.fixture(scope="module")
def pair(tmp_path_factory):
    """A thinly seeded pair behind two balls, as files."""
    folder = tmp_path_factory.mktemp("thin")
    scene = at_size(demo_scene("two_spheres_500"), 252)
    flow = Flow(Uniform((*SHIFT_MM, 0.0)))
    camera = FlowCamera(scene, flow, sheet=LightSheet(0.02), seeding=Seeding(0.006), reflections=None)
    (frames,) = render_pairs(scene, flow, dt_s=1.0, count=1, camera=camera)
    (folder / "scene.yaml").write_text(dump_scene(scene))
    for name, frame in zip("ab", frames, strict=True):
        tifffile.imwrite(folder / f"{name}.tif", frame)
    return folder


def given(pair, out, *options):
    paths = [str(pair / f"{name}.tif") for name in "ab"]
    return ["evaluate", *paths, "--scene", str(pair / "scene.yaml"), "-o", str(out), *options]


@pytest.mark.slow
@pytest.mark.draws
def test_tracks_are_a_file_a_table_and_a_chapter(pair, tmp_path, capsys):
    assert main(given(pair, tmp_path, "--tracking", "--shift-mm", *map(str, SHIFT_MM))) == DONE
    assert "single particles" in capsys.readouterr().out
    with netcdf_file(tmp_path / "tracks.nc", mmap=False) as file:
        columns = {name: variable[:].copy() for name, variable in file.variables.items()}
        assert file.variables["u"].units == b"mm"  # nobody said how long it took
        assert file.delta_t == 0.0
    assert set(columns) == {"x", "y", "u", "v", "sigma_u", "sigma_v", "branch"}
    assert len(set(columns["branch"])) == 2
    off = np.stack((columns["u"] - SHIFT_MM[0], columns["v"] - SHIFT_MM[1]))
    sigma = np.stack((columns["sigma_u"], columns["sigma_v"]))
    assert len(columns["u"]) > 200
    assert np.median(np.abs(off)) < 0.072  # a tenth of a pixel of 0.72 mm
    assert 0.55 < np.mean(np.abs(off) < sigma) < 0.80
    found = json.loads((tmp_path / "evaluation.json").read_text())["tracks"]
    assert {row["region"] for row in found} == BY_HAND
    assert sum(row["tracks"] for row in found) == len(columns["u"])
    assert all(0.0 < row["median_sigma_px"] < 0.5 for row in found)
    text = (tmp_path / "report.html").read_text()
    assert "Single particles" in text
    assert "errors within 1 sigma" in text


def test_without_a_known_shift_there_are_no_errors_and_with_a_time_there_are_velocities(pair, tmp_path):
    paths = [pair / "a.tif", pair / "b.tif"]
    (found,) = evaluate(
        paths, tmp_path / "tracks", pair / "scene.yaml", details=PairDetails(tracking=True)
    ).details
    assert found.tracks is not None
    row = json.loads((tmp_path / "tracks" / "evaluation.json").read_text())["tracks"][0]
    assert row["rms_error_px"] is None
    timed = replace(found, task=replace(found.task, out=tmp_path / "timed", dt_s=0.5))
    write_pair(timed)
    write_pair_page(timed)
    with netcdf_file(tmp_path / "timed" / "tracks.nc", mmap=False) as file:
        assert file.variables["u"].units == b"m s-1"
        assert np.allclose(file.variables["u"][:], found.tracks.vectors.shift_mm[:, 0] / 500.0)
        assert np.allclose(file.variables["sigma_v"][:], found.tracks.vectors.sigma_mm[:, 1] / 500.0)


def test_a_dewarped_camera_is_refused(pair, tmp_path, capsys):
    assert main(given(pair, tmp_path / "out", "--tracking", "--target-clear", str(pair / "a.tif"))) == USAGE
    error = capsys.readouterr().err
    assert "tracking traces raw pixels" in error
    assert len(error.strip().splitlines()) == 1
    assert not (tmp_path / "out").exists()


def test_too_few_particles_cost_no_vectors(pair, tmp_path, capsys):
    """Three particles in a frame of noise: the page says why there are no tracks."""
    rng = np.random.default_rng(0)
    frame = rng.normal(100.0, 5.0, (252, 252))
    for name in "ab":
        tifffile.imwrite(tmp_path / f"{name}.tif", np.clip(frame, 0, 4095).astype(np.uint16))
    (tmp_path / "scene.yaml").write_text((pair / "scene.yaml").read_text())
    assert main(given(tmp_path, tmp_path / "out", "--tracking")) == DONE
    assert "no tracks: only" in " ".join(capsys.readouterr().out.split())
    assert "particles match" in json.loads((tmp_path / "out" / "evaluation.json").read_text())["no_tracks"]
    assert not (tmp_path / "out" / "tracks.nc").exists()
