"""Names of files and folders in any script, in any locale: every file of results is written and can be read back.

The commands run in processes of their own, for the locale is read once, when Python starts.
"""

import json
import os
import re
import subprocess
import sys

import meshio
import numpy as np
import pytest
import tifffile
from scipy.io import loadmat

from ground.printable import utf8
from piv.files.vector_file import Variable, Vectors, netcdf, read_vectors, write_vectors
from rtpiv.command_line.cli import DONE, main
from tests.piv.conftest import make_pair

NAMES = ("Messung ä µ 漢 100% $x$", "Опыт №3 — 50 %d", "e\u0301té 🙂 [a] 'b'")  # the second letter is composed
ASCII = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0", "PYTHONIOENCODING": "ascii"}
LATIN = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0", "PYTHONIOENCODING": "latin-1"}
OPTIONS = ("--mm-per-px", "0.1", "--dt-us", "100", "--final-window", "32", "--workers", "1")


def run(*words, **environment):
    """Run one command; what it printed."""
    done = subprocess.run(
        [sys.executable, "-m", "rtpiv", *map(os.fsencode, words)],
        capture_output=True,
        check=False,
        env=os.environ | environment,
    )
    assert done.returncode == DONE, done.stderr.decode("utf-8", "replace")
    assert b"Traceback" not in done.stderr
    return done.stdout


def a_day(folder, stem, count=2):
    folder.mkdir(parents=True)
    for number in range(count):
        for letter, image in zip("ab", make_pair(lambda u, v: (2.0, 1.0), (64, 64), seed=number), strict=True):
            tifffile.imwrite(folder / f"{stem} {number:03d}_{letter}.tif", image)
    return folder


@pytest.mark.parametrize("environment", [{}, ASCII, LATIN], ids=["utf-8", "ascii", "latin-1"])
def test_series_mean_page_and_exports_of_any_name(tmp_path, environment):
    for name in NAMES if environment == ASCII else NAMES[:1]:
        day, out = a_day(tmp_path / name, name), tmp_path / f"out {name}"
        run("mean", day, *OPTIONS, "-o", out, **environment)
        assert f"<h1>{name}: mean flow".replace("'", "&#x27;") in (out / "mean.html").read_text("utf-8")
        assert json.loads((out / "series.json").read_text("utf-8"))["run"] == name
        vectors = read_vectors(out / "mean.nc")
        assert vectors.attributes["run"] == name
        if name != NAMES[0] or environment == LATIN:  # the rest is once more the same
            continue
        again = run("mean", day, *OPTIONS, "-o", out, **environment)  # the folder is known as that of this day
        assert b"had been evaluated before" in again
        for to in ("matlab", "paraview", "tecplot"):
            run("export", out / "mean.nc", "--to", to, "-o", tmp_path / f"{name} {to}", **environment)
        u = vectors.fields["u"][0]
        np.testing.assert_allclose(loadmat(tmp_path / f"{name} matlab/mean.mat")["u"][..., 0], u)
        assert meshio.read(tmp_path / f"{name} paraview/mean.vtk").point_data["u"].size == u.size
        assert (tmp_path / f"{name} tecplot/mean.dat").read_text("utf-8")


def test_a_pair_with_every_file_beside_its_vectors(tmp_path):
    day = a_day(tmp_path / NAMES[2], NAMES[0], 1)
    frames = sorted(day.iterdir())
    out = tmp_path / NAMES[1]
    run("evaluate", *frames, *OPTIONS, "--vtk", "--figures", "-o", out, **ASCII)
    about = json.loads((out / "evaluation.json").read_text("utf-8"))
    assert NAMES[0] in about["frames"]
    assert NAMES[0] in read_vectors(out / "vectors.nc").attributes["frames"]
    assert NAMES[0] in (out / "report.html").read_text("utf-8")
    assert meshio.read(out / "vectors.vtk").point_data


def test_a_name_of_bytes_that_are_no_letters(tmp_path):
    day = a_day(tmp_path / os.fsdecode(b"lat\xe4in \xff"), os.fsdecode(b"\xfcber"))
    out = tmp_path / os.fsdecode(b"\xe9valu\xe9")
    run("mean", day, *OPTIONS, "-o", out)
    assert read_vectors(out / "mean.nc").attributes["run"] == "lat\ufffdin \ufffd"
    assert b"had been evaluated before" in run("mean", day, *OPTIONS, "-o", out)


def test_titles_units_and_notes_of_variables(tmp_path):
    said = netcdf({"t": Variable(("t",), np.zeros(2), "°C", {"note": "Öl 漢"})}, {"title": "µ", "raw": "\ud800"})
    assert "°C".encode() in said
    assert "Öl 漢".encode() in said
    place = np.arange(2.0)
    fields = {name: np.ones((1, 2, 2)) for name in "uv"}
    for title in ("漢" * 200, "two\nlines ä", 'quoted "ö"'):
        write_vectors(tmp_path / "a.nc", Vectors(place, place, place[:1], fields, attributes={"title": title}))
        for to in ("matlab", "paraview", "tecplot"):
            assert main(["export", str(tmp_path / "a.nc"), "--to", to, "-o", str(tmp_path / to)]) == DONE
            for file in (tmp_path / to).iterdir():
                file.replace(tmp_path / file.name)
        assert meshio.read(tmp_path / "a.vtk").point_data["u"].size == 4
        assert str(loadmat(tmp_path / "a.mat")["title"][0])[:3] == title.replace('"', "").replace("\n", " ")[:3]
        assert re.match(r'TITLE = "[^"\n]*"\n', (tmp_path / "a.dat").read_text("utf-8"))


@pytest.mark.parametrize(
    ("text", "written"),
    [("ä", "ä"), ("\udcc3\udca4", "ä"), ("\udce4x", "\ufffdx"), ("\ud800漢", "?漢"), ("plain", "plain")],
)
def test_any_text_becomes_utf_8(text, written):
    assert utf8(text).decode() == written
