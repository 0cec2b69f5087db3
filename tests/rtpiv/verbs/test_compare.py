"""`rtpiv compare`: its files, and whether the sigma that it foretells is the one that a fit leaves."""

import csv
from pathlib import Path

import numpy as np
import pytest

from correction.fit.solve.light import light_uncertainty
from correction.fitted.scene_sigma import SceneSigma
from correction.maps.correction_map import build_correction_map
from correction.target.board_file import read_board, write_board
from daq.errors import RunUsageError
from rtpiv.analysis.views.candidates import ViewQuestion
from rtpiv.analysis.views.figures import view_figures, with_sigma
from rtpiv.command_line.cli import DONE, USAGE, main
from rtpiv.templates.lab import Lab
from rtpiv.verbs.acquire import acquire
from rtpiv.verbs.calibrate import calibrate
from rtpiv.verbs.compare import compare
from rtpiv.verbs.init import GivenLab, init
from tracer.scene.scene_file import load_scene
from tracer.strategies.ray_map import build_ray_map


@pytest.mark.slow
@pytest.mark.draws
def test_every_arrangement_is_in_the_file_and_the_best_have_scenes(tmp_path, capsys):
    words = ["compare", "--lenses-mm", "60", "--distances-mm", "500", "--balls-mm", "50", "--counts", "1", "2"]
    words += ["--gaps-mm", "0", "4", "-o"]
    assert main([*words, str(tmp_path / "out")]) == DONE
    rows = list(csv.DictReader((tmp_path / "out" / "compare.csv").read_text().splitlines()))
    assert {(row["balls"], row["gap_mm"]) for row in rows} == {("1", "0"), ("1", "4"), ("2", "0"), ("2", "4")}
    first = load_scene(tmp_path / "out" / "scenes" / "01.yaml")
    assert len(first.spheres) == int(rows[0]["balls"]) == 2
    assert float(rows[0]["sigma_px"]) > 0.0
    assert (tmp_path / "out" / "compare.png").stat().st_size > 10000
    assert "2 x 50 BK7" in capsys.readouterr().out


def test_what_cannot_be_is_one_sentence(tmp_path, capsys):
    words = ["compare", "--lenses-mm", "60", "--distances-mm", "50", "--balls-mm", "50", "-o"]
    assert main([*words, str(tmp_path / "out")]) == USAGE
    assert "cannot focus" in capsys.readouterr().err


def test_where_nothing_is_of_use_that_is_said(tmp_path, capsys):
    words = ["compare", "--lenses-mm", "105", "--distances-mm", "400", "--balls-mm", "50", "--glasses", "1.53"]
    assert main([*words, "--counts", "2", "--error-px", "0.001", "-o", str(tmp_path)]) == DONE
    assert "none of 1 arrangements shows anything" in capsys.readouterr().out
    assert len((tmp_path / "compare.csv").read_text().splitlines()) == 2
    assert (
        main([*words, "--counts", "2", "--error-px", "5", "-o", str(tmp_path)]) == DONE
    )  # glass that is a number


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize(
    "lab",
    [
        Lab(balls=2, ball_mm=40.0, lens_mm=35.0, distance_mm=350.0, sensor_px=(1008, 1008), pixel_pitch_um=11.0),
        Lab(balls=1, lens_mm=50.0, distance_mm=400.0, sensor_px=(1008, 1008), pixel_pitch_um=11.0),
    ],
)
def test_sigma_is_what_a_fit_leaves(tmp_path, monkeypatch, lab):
    keys = ("sensor_px", "pixel_pitch_um", "lens_mm", "distance_mm", "balls", "ball_mm", "glass", "gap_mm")
    init(tmp_path, GivenLab(arrangement=lab.arrangement, **{key: getattr(lab, key) for key in keys}))
    monkeypatch.chdir(tmp_path)
    printed = read_board(Path("board.yaml"))
    exact = {"measured_mm": printed.bars_mm, "read_sigma_mm": 1e-3}
    write_board(Path("board.yaml"), printed.model_copy(update=exact))
    run = acquire("plan-target.yaml", bench="bench.yaml", simulate=True, home=True)
    calibrate(run, out="fit", pictures=False)
    scene, known = load_scene("fit/scene.yaml"), SceneSigma.load("fit/fit.npz")
    found = build_correction_map(scene, build_ray_map(scene))
    pixel = found.pixel[0][found.behind_glass][::50]
    told = with_sigma(view_figures(lab, 22.0, 0.1))
    unsaid = known.with_draw(light_uncertainty(scene, None).step)  # `init` says the light
    for sure, expected in ((known, told.sigma_px), (unsaid, told.unsaid_px)):
        fitted = np.nanmedian(np.linalg.norm(sure.sigma(scene, pixel), axis=1)) * lab.px_per_mm
        assert expected == pytest.approx(fitted, rel=0.3)


def test_balls_that_the_camera_hardly_sees_are_no_error_of_ours(tmp_path):
    with pytest.raises(RunUsageError, match=r"a lens of 0\.5 mm at 532 mm sees balls of 8 mm"):
        compare(ViewQuestion([0.5], [532.0], [8.0]), out=tmp_path, pictures=False)


def test_a_python_call_gives_the_figures(tmp_path):
    made = compare(ViewQuestion([60.0], [500.0], [50.0], [2]), out=tmp_path, error_px=0.2, pictures=False)
    assert made.picture is None
    assert made.best[0].lab.balls == 2
    assert made.best[0].usable > 0.8
