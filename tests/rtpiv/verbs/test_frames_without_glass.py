"""Frames without glass and without a scene: what a pixel shows is told, and vectors are in m/s."""

import html
import re

import numpy as np
import pytest
import tifffile

from correction import Corrector, build_correction_map
from piv.files.vector_file import read_vectors
from rtpiv.analysis.recipe import CorrectionRecipe
from rtpiv.command_line.cli import DONE, USAGE, main
from tests.piv.conftest import make_pair
from tracer.scene.scene_file import load_scene
from tracer.strategies.ray_map import build_ray_map

MM, DT_US, SHIFT = 0.04, 200.0, (3.2, -1.7)
TOLD = ["--mm-per-px", str(MM), "--dt-us", str(DT_US), "--final-window", "32", "--workers", "1"]


@pytest.fixture(scope="module")
def day(tmp_path_factory):
    folder = tmp_path_factory.mktemp("day")
    for number in range(3):
        pair = make_pair(lambda u, v: SHIFT, (96, 140), seed=number)
        for second, image in enumerate(pair):
            tifffile.imwrite(folder / f"im{2 * number + second:04d}.tif", image)
    return folder


def right(folder, name="vectors.nc"):
    """Velocities are the shift's, x to the right and y up."""
    vectors = read_vectors(folder / name)
    assert vectors.units["u"] == "m s-1"
    assert "dxdz" not in vectors.by_place  # nothing is known of the camera that would tell
    u, v = (float(np.nanmedian(vectors.fields[name])) for name in ("u", "v"))
    m_s_per_px = 1e-3 * MM / (1e-6 * DT_US)
    np.testing.assert_allclose((u, v), np.multiply(SHIFT, m_s_per_px) * (1.0, -1.0), atol=0.03 * m_s_per_px)
    return True


def test_two_frames_are_evaluated_in_metres_a_second(day, tmp_path, capsys):
    frames = [str(day / f"im{n:04d}.tif") for n in (0, 1)]
    assert main(["evaluate", *frames, *TOLD, "-o", str(tmp_path / "out"), "--no-pictures"]) == DONE
    assert right(tmp_path / "out")
    said = " ".join(capsys.readouterr().out.split())
    assert "The scale is taken as exact (0.04 mm/px); the uncertainties do not include its error" in said
    assert "rtpiv calibrate" not in said


@pytest.mark.slow
@pytest.mark.draws
def test_a_folder_is_averaged_in_one_command(day, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["mean", str(day), "--ensemble", "16", *TOLD]) == DONE
    assert "mean of 3 pairs" in capsys.readouterr().out
    assert "pairs in the mean" in (tmp_path / "evaluation" / "mean.html").read_text()
    assert right(tmp_path / "evaluation", "mean_ensemble.nc")


@pytest.mark.usefixtures("no_mean_page")
def test_a_mean_goes_on_in_its_folder_and_with_another_ruler_begins_anew(day, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for _ in range(2):
        assert main(["mean", str(day), *TOLD]) == DONE
        assert "mean of 3 pairs" in capsys.readouterr().out
    assert right(tmp_path / "evaluation", "mean.nc")
    (tmp_path / "evaluation" / "fit.npz").write_bytes(b"of another scene")
    assert main(["mean", str(day), "--mm-per-px", str(2 * MM), *TOLD[2:]]) == DONE  # the ruler was read wrongly
    u = read_vectors(tmp_path / "evaluation" / "mean.nc").fields["u"]
    assert float(np.nanmedian(u)) == pytest.approx(2e-3 * SHIFT[0] * MM / (1e-6 * DT_US), rel=0.01)
    assert not (tmp_path / "evaluation" / "fit.npz").exists()


def test_a_frame_passes_its_scene_unchanged(day, tmp_path):
    """A pixel is a node: nothing is interpolated that was not measured."""
    frame = day / "im0000.tif"
    scene = load_scene(CorrectionRecipe(mm_per_px=MM).scene_of(None, frame, tmp_path))
    image = tifffile.imread(frame)
    corrected = Corrector(build_correction_map(scene, build_ray_map(scene)))(image)
    np.testing.assert_allclose(corrected[4:-4, 4:-4], image[4:-4, 4:-4], atol=0.01)


def test_a_scale_and_a_scene_are_one_too_many(day, tmp_path, capsys):
    (tmp_path / "scene.yaml").write_text("bodies: []\n")
    frames = [str(day / f"im{n:04d}.tif") for n in (0, 1)]
    assert main(["evaluate", *frames, "--scene", str(tmp_path / "scene.yaml"), *TOLD]) == USAGE
    assert "leave it or --scene out" in capsys.readouterr().err
    assert main(["correct", frames[0], "--scene", str(tmp_path / "scene.yaml"), "--mm-per-px", "0.04"]) == USAGE
    assert "omit --mm-per-px" in capsys.readouterr().err
    with pytest.raises(SystemExit, match=str(USAGE)):
        main(["evaluate", *frames, "--mm-per-px", "-0.04"])
    assert "--mm-per-px: should be above 0" in capsys.readouterr().err


WORDS_OF_GLASS = (
    r"\b(glass|scene|camera'?s?|ball|sphere|bod(y|ies)|rim|seen directly|recovered|correction|corrected)\b"
)
BY_NAME = r"nothing is known of the camera|The viewing direction is not known"  # what is told instead of them


def words_of(page):
    """What a person reads on a page."""
    text = re.sub(r"(?s)<style.*?</style>|<[^>]*>", " ", page.read_text())
    return re.sub(BY_NAME, "", html.unescape(" ".join(text.split())))


@pytest.mark.slow
def test_pages_of_frames_without_glass_do_not_speak_of_it(day, tmp_path, capsys):
    frames = [str(day / f"im{n:04d}.tif") for n in (0, 1)]
    told = [*TOLD[:4], "--final-window", "16", "--workers", "1"]
    assert main(["evaluate", *frames, *told, "-o", str(tmp_path / "one")]) == DONE
    known = ["--mm-per-px", str(MM), "--shift-mm", str(SHIFT[0] * MM), str(-SHIFT[1] * MM)]
    assert main(["evaluate", *frames, *known, "-o", str(tmp_path / "known")]) == DONE
    assert main(["evaluate", str(day), *told, "-o", str(tmp_path / "many")]) == DONE
    assert main(["mean", str(tmp_path / "many")]) == DONE
    pages = [
        *(tmp_path / name / "report.html" for name in ("one", "known", "many")),
        tmp_path / "many" / "mean.html",
    ]
    for said in [*map(words_of, pages), re.sub(BY_NAME, "", " ".join(capsys.readouterr().out.split()))]:
        found = re.search(f".{{0,60}}{WORDS_OF_GLASS}.{{0,60}}", said)
        assert found is None, found[0]
