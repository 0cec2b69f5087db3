"""Names of files and folders in any script, in any locale: every file of results is written and can be read back.

The commands run in processes of their own, for the locale is read once, when Python starts.
"""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import meshio
import numpy as np
import tifffile
from scipy.io import loadmat

from ground.printable import utf8
from piv.files.vector_file import Variable, Vectors, netcdf, read_vectors, write_vectors
from rtpiv.command_line.cli import DONE, main
from tests.loops import loop_over
from tests.piv.conftest import make_pair

NAMES = ("Messung ä µ 漢 100% $x$", "Опыт №3 — 50 %d", "e\u0301té 🙂 [a] 'b'")  # the second letter is composed
ASCII = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0", "PYTHONIOENCODING": "ascii"}
LATIN = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0", "PYTHONIOENCODING": "latin-1"}
EXPORTS = "matlab", "paraview", "tecplot", "csv"
OPTIONS = ("--mm-per-px", "0.1", "--dt-us", "100", "--final-window", "32", "--workers", "1")


MAIN = """
import sys
from rtpiv.command_line.cli import main
from tests.rtpiv.conftest import undrawn
with undrawn():
    sys.exit(max(main(words.split("\\n")) for words in sys.argv[1:]))
"""


def run(*commands, **environment):
    """Run commands in one process of their own; what they printed."""
    words = [b"\n".join(map(os.fsencode, command)) for command in commands]
    done = subprocess.run(
        [sys.executable, "-c", MAIN, *words], capture_output=True, check=False,
        env=os.environ | {"PYTHONPATH": str(Path.cwd())} | environment,
    )  # fmt: skip
    assert done.returncode == DONE, done.stderr.decode("utf-8", "replace")
    assert b"Traceback" not in done.stderr
    return done.stdout


def a_day(folder, stem, count=2):
    folder.mkdir(parents=True)
    for number in range(count):
        for letter, image in zip("ab", make_pair(lambda u, v: (2.0, 1.0), (64, 64), seed=number), strict=True):
            tifffile.imwrite(folder / f"{stem} {number:03d}_{letter}.tif", image)
    return folder


def test_series_mean_page_and_exports_of_any_name(tmp_path):
    day, out = a_day(tmp_path / NAMES[0], NAMES[0]), tmp_path / f"out {NAMES[0]}"
    odd = a_day(tmp_path / os.fsdecode(b"lat\xe4in \xff"), os.fsdecode(b"\xfcber"))  # bytes that are no letters
    frames = sorted(a_day(tmp_path / NAMES[2], NAMES[0], 1).iterdir())
    mean = ["mean", day, *OPTIONS, "-o", out]
    plain = ["evaluate", odd, *OPTIONS, "--no-pictures", "-o", tmp_path / os.fsdecode(b"\xe9valu\xe9")]
    said = run(
        mean,
        *(["export", out / "mean.nc", "--to", to, "-o", tmp_path / f"{NAMES[1]} {to}"] for to in EXPORTS),
        ["evaluate", *frames, *OPTIONS, "--vtk", "-o", tmp_path / NAMES[1]],
        plain,
        plain,  # the folder is known as that of this day
        **ASCII,
    )
    assert b"had been evaluated before" in said
    assert f"<h1>{NAMES[0]}: mean flow" in (out / "mean.html").read_text("utf-8")
    assert json.loads((out / "series.json").read_text("utf-8"))["run"] == NAMES[0]
    vectors = read_vectors(out / "mean.nc")
    assert vectors.attributes["run"] == NAMES[0]
    u = vectors.fields["u"][0]
    np.testing.assert_allclose(loadmat(tmp_path / f"{NAMES[1]} matlab/mean.mat")["u"][..., 0], u)
    assert meshio.read(tmp_path / f"{NAMES[1]} paraview/mean.vtk").point_data["u"].size == u.size
    for ending in ("tecplot/mean.dat", "csv/mean.csv"):
        assert (tmp_path / f"{NAMES[1]} {ending}").read_text("utf-8")
    pair = tmp_path / NAMES[1]
    assert NAMES[0] in json.loads((pair / "evaluation.json").read_text("utf-8"))["frames"]
    assert NAMES[0] in read_vectors(pair / "vectors.nc").attributes["frames"]
    assert NAMES[0] in (pair / "report.html").read_text("utf-8")
    assert meshio.read(pair / "vectors.vtk").point_data
    series = tmp_path / os.fsdecode(b"\xe9valu\xe9") / "series.json"
    assert json.loads(series.read_text("utf-8"))["run"] == "lat\ufffdin \ufffd"


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


@loop_over(
    "text, written",
    [("ä", "ä"), ("\udcc3\udca4", "ä"), ("\udce4x", "\ufffdx"), ("\ud800漢", "?漢"), ("plain", "plain")],
)
def test_any_text_becomes_utf_8(text, written):
    assert utf8(text).decode() == written
