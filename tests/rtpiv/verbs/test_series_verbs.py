"""A flow run by one command: vectors, mean and pages; mistakes are one sentence with its exit code."""

import json

import numpy as np
import pytest
from scipy.io import netcdf_file

from piv.correlation import pair
from piv.files.vector_file import read_vectors
from rtpiv.analysis.series.series_plan import chunk_path
from rtpiv.command_line.cli import DONE, USAGE, main
from tests.loops import loop_over
from tests.rtpiv.analysis.series.small_series import DT_US, PX_PER_MM, SCENE, content_of, flow_run

PAIRS = 6
WINDOWS = ("--first-window", "32", "--final-window", "16", "--workers", "1")


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return flow_run(tmp_path_factory.mktemp("flow"), PAIRS, unseeded=2)


def test_mean_takes_a_run_and_then_its_series(run, monkeypatch, capsys):
    """Evaluated once, averaged twice: the same file; mean.nc says mean, stresses and their uncertainty."""
    with monkeypatch.context() as without_page:  # that of the series alone takes its place
        without_page.setattr("rtpiv.analysis.report.mean.write_mean_page", lambda *given: None)
        assert main(["mean", str(run), *WINDOWS]) == DONE
    out = run / "series"
    said = capsys.readouterr()
    assert f"{PAIRS} of {PAIRS} pairs have vectors" in said.out
    assert "no map uncertainty: there is no fit" in said.out
    assert f"{PAIRS}/{PAIRS}" in said.err  # progress
    first = (out / "mean.nc").read_bytes()
    assert main(["mean", str(out)]) == DONE
    assert (out / "mean.nc").read_bytes() == first
    with netcdf_file(out / "mean.nc", mmap=False) as file:
        found = {name: np.array(each[:]) for name, each in file.variables.items()}
        assert file.pairs_used == PAIRS
    m_s = 1e-3 / PX_PER_MM / (DT_US * 1e-6)
    assert np.nanmedian(found["u"]) == pytest.approx(2.0 * m_s, rel=0.01)
    assert np.nanmedian(found["v"]) == pytest.approx(1.0 * m_s, rel=0.01)
    assert found["n"].max() == PAIRS
    assert found["n_effective_u"].shape == found["u"].shape
    noisy, clean, noise = (np.nanmedian(found[name]) for name in ("R_uu_measured", "R_uu", "noise_uu"))
    assert noisy > clean
    assert noise > 0.0
    page = (out / "mean.html").read_text()
    assert "pairs in the mean" in page
    assert "without background" not in page  # of the series alone: its frames may be elsewhere
    report = run / "report"
    assert main(["report", str(run), "-o", str(report), "--first-window", "32", "--final-window", "16"]) == DONE
    page = (report / "mean.html").read_text()
    for text in ("pairs in the mean", "<i>without background</i>", "Frame account"):
        assert text in page


def test_evaluate_of_a_flow_run_leaves_one_page_that_shows_every_step(run, tmp_path, capsys):
    out = tmp_path / "out"
    steps = ("--prepare", "sliding-minimum,min-max")
    assert main(["evaluate", str(run), "-o", str(out), *WINDOWS, *steps]) == DONE
    page = (out / "report.html").read_text()
    for layer in ("as acquired", "without background", "corrected", "min-max", "mask"):
        assert f"<i>{layer}</i>" in page
    assert "is taken off" in page
    assert not list(out.glob("flow_*"))  # no page a pair
    assert main(["evaluate", str(run), "-o", str(out), *WINDOWS, *steps]) == DONE
    assert f"{PAIRS} of them had been evaluated before" in capsys.readouterr().out


def test_an_empty_series_and_a_stranger_are_no_series(tmp_path, run, capsys):
    for path in (tmp_path, tmp_path / "nothing"):
        assert main(["mean", str(path)]) == USAGE
        assert "is neither a run, nor frames in pairs, nor the folder of a series" in capsys.readouterr().err


@loop_over(
    "words, said",
    [
        (("--prepare", "clahe"), "moves correlation peaks"),
        (("--prepare", "min-max,sliding-minimum"), "raw frames come first"),
        (("--dt-us", "70"), "leave that out"),
        (("--square-mm", "3"), "the options say 3"),
        (("--prepare", "pod"), "need 12 frames"),
        (("--scene", "nowhere.yaml"), "nowhere.yaml"),
    ],
)
def test_what_cannot_be_meant_is_one_sentence(run, tmp_path, capsys, words, said):
    for verb in ("mean", "evaluate"):
        assert main([verb, str(run), "-o", str(tmp_path / "out"), *WINDOWS, *words]) == USAGE
        error = capsys.readouterr().err
        assert said in error
        assert len(error.strip().splitlines()) == 1


@pytest.mark.slow
def test_every_pair_of_a_series_can_be_asked_for_more(run, tmp_path):
    """Errors against a known shift, tracks and VTK, of a series as of two frames; its vectors stay the same."""
    words = [str(run), *WINDOWS, "--workers", "1", "--no-pictures"]
    assert main(["evaluate", *words, "-o", str(tmp_path / "plain")]) == DONE
    shift_mm = ("2.5", "1.25")  # 2 px right, 1 px up
    more = ("--shift-mm", *shift_mm, "--tracking", "--vtk")
    assert main(["evaluate", *words, "-o", str(tmp_path / "out"), *more]) == DONE
    assert content_of(tmp_path / "out") == content_of(tmp_path / "plain")
    folders = sorted(path for path in (tmp_path / "out").glob("flow_*"))
    assert len(folders) == PAIRS
    cut = json.loads((tmp_path / "out" / "series.json").read_text())["chunk_pairs"]
    for place, folder in enumerate(folders):
        assert {"vectors.nc", "vectors.vtk", "evaluation.json", "tracks.nc"} <= {p.name for p in folder.iterdir()}
        said = json.loads((folder / "evaluation.json").read_text())
        assert max(map(abs, said["shift"]["regions"]["seen directly"]["bias_px"])) < 0.1
        chunk, row = chunk_path(tmp_path / "out", place // cut), place % cut
        one, all_of_them = read_vectors(folder / "vectors.nc"), read_vectors(chunk)
        for name in ("u", "v", "sigma_u", "flag"):
            assert one.fields[name][0].tobytes() == all_of_them.fields[name][row].tobytes()


def test_a_pair_is_correlated_once_however_much_is_asked_of_it(tmp_path, mocker):
    """Its vectors, its folder and the page of the series: all from one correlation; a whole chunk is kept."""
    correlated, pairs, out = mocker.spy(pair, "prepare_pair"), 2, tmp_path / "out"
    words = ["evaluate", str(flow_run(tmp_path, pairs)), *WINDOWS, "-o", str(out), "--vtk"]
    assert main(words) == DONE
    assert correlated.call_count == pairs
    chunk = chunk_path(out, 0)
    before = chunk.read_bytes(), chunk.stat().st_mtime_ns
    assert main([*words, "--no-pictures"]) == DONE
    assert correlated.call_count == 2 * pairs
    assert (chunk.read_bytes(), chunk.stat().st_mtime_ns) == before
    assert len(list(out.glob("flow_*/vectors.vtk"))) == pairs


@pytest.mark.usefixtures("no_mean_page")
def test_what_a_pair_cannot_have_is_one_sentence(run, tmp_path, capsys):
    out = ("-o", str(tmp_path / "out"))
    frames = [str(path) for path in sorted((run / "frames").iterdir())[:2]]
    (tmp_path / "scene.yaml").write_text(SCENE)
    scene = ("--scene", str(tmp_path / "scene.yaml"))
    assert main(["evaluate", *frames, *scene, *out, "--prepare", "sliding-minimum"]) == USAGE
    assert "needs a series of pairs" in capsys.readouterr().err
    assert main(["mean", str(run), *WINDOWS]) == DONE
    capsys.readouterr()
    assert main(["mean", str(run / "series"), "--final-window", "32"]) == USAGE
    assert "its vectors are made" in capsys.readouterr().err
