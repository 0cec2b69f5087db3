"""Frames alone: no scene, no scale, no time. Vectors and means are displacements, in pixels or mm, and say so."""

import csv
import re

import numpy as np
import pytest
import tifffile

from piv.files.vector_file import read_vectors
from rtpiv.command_line.cli import DONE, USAGE, main
from tests.piv.conftest import make_pair
from tests.slow_cases import slow

SHIFT = (3.0, -1.5)
MORE = ["--final-window", "32"]


@pytest.fixture(scope="module")
def day(tmp_path_factory):
    folder = tmp_path_factory.mktemp("day")
    for number in range(3):
        for letter, image in zip("ab", make_pair(lambda u, v: SHIFT, (96, 112), seed=number), strict=True):
            tifffile.imwrite(folder / f"B{number:03d}_{letter}.tif", image)
    return folder


def right(path, unit, scale=1.0):
    """Whether u and v are the shift's in a unit, with places and squares in that unit as well."""
    vectors = read_vectors(path)
    assert vectors.kind == "displacement"
    assert {vectors.units[name] for name in ("u", "v", "sigma_u", "total_sigma_u")} == {unit}
    assert vectors.length_unit == unit
    found = [float(np.nanmedian(vectors.fields[name])) for name in "uv"]
    np.testing.assert_allclose(found, (scale * SHIFT[0], -scale * SHIFT[1]), atol=0.03 * scale)
    if "R_uu" in vectors.units:
        assert vectors.units["R_uu"] == f"{unit}2"
        assert vectors.units["vorticity"] == "1"
    return vectors


def words_of(page):
    """Text of a page without its pictures, whose letters may spell anything."""
    return re.sub(r'src="data:[^"]*"', "", page.read_text("utf-8"))


def test_two_frames_alone_are_evaluated_in_pixels(day, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    frames = [str(day / f"B000_{letter}.tif") for letter in "ab"]
    assert main(["evaluate", *frames]) == DONE
    vectors = right(tmp_path / "evaluation" / "vectors.nc", "pixel")
    np.testing.assert_allclose(np.diff(vectors.x_mm), vectors.x_mm[1] - vectors.x_mm[0])
    said = " ".join(capsys.readouterr().out.split())
    assert "No scale is given (--mm-per-px, or --scene), so lengths are pixels" in said
    assert "displacement x, y [px]" in said
    page = words_of(tmp_path / "evaluation" / "report.html")
    assert "[mm]" not in page
    assert main(["evaluate", *frames, "--dt-us", "100", "-o", str(tmp_path / "timed"), "--no-pictures"]) == DONE
    right(tmp_path / "timed" / "vectors.nc", "pixel")  # a time makes no velocity of pixels


@pytest.mark.parametrize(
    ("more", "unit", "scale"),
    [slow([], "pixel", 1.0), (["--mm-per-px", "0.2"], "mm", 0.2), slow(["--dt-us", "9"], "pixel", 1.0)],
)
def test_a_mean_without_a_time_is_one_of_displacements(day, tmp_path, capsys, more, unit, scale):
    assert main(["mean", str(day), *MORE, *more, "--workers", "1", "-o", str(tmp_path / "out")]) == DONE
    right(tmp_path / "out" / "mean.nc", unit, scale)
    said = capsys.readouterr().out
    short = "px" if unit == "pixel" else "mm"
    assert f"mean [{short}]" in said
    assert f"[{short}²]" in said
    page = words_of(tmp_path / "out" / "mean.html")
    for words in (said, page):
        assert "m/s" not in words
        assert "1/s" not in words
    if short == "px":
        assert "[mm]" not in page


@pytest.mark.usefixtures("no_mean_page")
def test_the_mean_of_a_series_that_was_evaluated_without_a_time(day, tmp_path, capsys):
    assert (
        main(["evaluate", str(day), *MORE, "--no-pictures", "--workers", "1", "-o", str(tmp_path / "out")]) == DONE
    )
    assert f"average with: rtpiv mean {tmp_path / 'out'}" in "".join(capsys.readouterr().out.split("\n"))
    assert main(["mean", str(tmp_path / "out")]) == DONE
    right(tmp_path / "out" / "mean.nc", "pixel")


@pytest.mark.usefixtures("no_mean_page")
def test_the_ensemble_mean_has_the_same_units(day, tmp_path):
    words = ["mean", str(day), *MORE, "--ensemble", "32", "--workers", "1", "-o", str(tmp_path / "out")]
    assert main(words) == DONE
    found = read_vectors(tmp_path / "out" / "mean_ensemble.nc")
    assert (found.units["u"], found.units["R_uu"], found.length_unit) == ("pixel", "pixel2", "pixel")
    assert float(np.nanmedian(found.fields["u"])) == pytest.approx(SHIFT[0], abs=0.05)


def test_what_is_no_frame_is_refused_as_before(day, tmp_path, capsys):
    for words in ([str(day / "B000_a.tif")], [str(day / "nothing.tif"), str(day / "B000_a.tif")], [str(tmp_path)]):
        assert main(["evaluate", *words, "-o", str(tmp_path / "out")]) == USAGE
        assert len(capsys.readouterr().err.strip().splitlines()) == 1


@pytest.mark.parametrize("timed", [True, False])
def test_csv_is_a_table_of_every_place(day, tmp_path, timed):
    more = ["--mm-per-px", "0.1", "--dt-us", "100"] if timed else []
    frames = [str(day / f"B000_{letter}.tif") for letter in "ab"]
    assert main(["evaluate", *frames, *more, *MORE, "--no-pictures", "-o", str(tmp_path / "out")]) == DONE
    assert main(["export", str(tmp_path / "out/vectors.nc"), "--to", "csv", "-o", str(tmp_path / "csv")]) == DONE
    vectors = read_vectors(tmp_path / "out" / "vectors.nc")
    with (tmp_path / "csv" / "vectors.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    u, x = ("u [m s-1]", "x [mm]") if timed else ("u [pixel]", "x [pixel]")
    assert len(rows) == vectors.measured.size
    read = np.array([float(row[u] or "nan") for row in rows])
    np.testing.assert_allclose(read, vectors.fields["u"].ravel(), rtol=1e-6)
    np.testing.assert_allclose([float(row[x]) for row in rows[: len(vectors.x_mm)]], vectors.x_mm, atol=1e-6)
    assert [row["measured"] == "1" for row in rows] == vectors.measured.ravel().tolist()


def test_csv_has_nothing_where_nothing_was_measured(tmp_path):
    from piv.files.vector_file import Vectors, write_vectors

    u = np.array([[[1.5, np.nan], [2.5, -1e-7]], [[np.inf, 3.0], [4.0, 5.0]]])
    place = np.array([0.25, 1.0])
    write_vectors(tmp_path / "a.nc", Vectors(place, place, place, {"u": u, "v": -u}, {"delta_t": place}))
    assert main(["export", str(tmp_path / "a.nc"), "--to", "csv", "-o", str(tmp_path / "csv")]) == DONE
    lines = (tmp_path / "csv" / "a.csv").read_text("utf-8").splitlines()
    assert lines[0].split(",")[:4] == ["t [s]", "x [mm]", "y [mm]", "u [1]"]
    assert lines[2].split(",")[3:5] == ["", ""]
    assert len(lines) == 1 + u.size
