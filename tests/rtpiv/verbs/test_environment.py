"""Settings of a user's shell, home or script, which change neither vectors nor pictures."""

import os
import subprocess
import sys
from hashlib import sha256

import matplotlib as mpl
import numpy as np
import pytest
import tifffile

import rtpiv
from piv.files.vector_file import read_vectors
from rtpiv.analysis.pictures.plane_axes import bare_figure, log_scale
from rtpiv.analysis.recipe import CorrectionRecipe
from rtpiv.command_line.cli import DONE
from rtpiv.verbs.evaluate import EvaluationOutput
from tests.piv.conftest import make_pair

STYLE = "text.usetex: True\naxes.grid: True\nfont.family: NoSuchFont\naxes.facecolor: red\n"
UNUSUAL = {
    "MPLBACKEND": "no such backend", "MATPLOTLIBRC": "style", "NUMBA_DISABLE_JIT": "1", "NUMBA_NUM_THREADS": "0",
}  # fmt: skip


@pytest.fixture(scope="module")
def day(tmp_path_factory):
    folder = tmp_path_factory.mktemp("day")
    (folder / "style").mkdir()
    (folder / "style/matplotlibrc").write_text(STYLE)
    for letter, image in zip("ab", make_pair(lambda u, v: (2.0, 1.0), (64, 64)), strict=True):
        tifffile.imwrite(folder / f"im_{letter}.tif", image)
    return folder


@pytest.fixture(scope="module")
def plain(day):
    """Folder with what a script of other settings than those below evaluates and draws; it keeps its own."""
    with mpl.rc_context({"text.usetex": True, "axes.edgecolor": "green", "figure.dpi": 37.0}):
        before = dict(mpl.rcParams)
        rtpiv.evaluate(
            [day / "im_a.tif", day / "im_b.tif"],
            out=day / "plain",
            recipe=CorrectionRecipe(mm_per_px=0.1),
            output=EvaluationOutput(figures=True),
        )
        assert dict(mpl.rcParams) == before
    return day / "plain"


def command(folder, out, environment):
    words = ["evaluate", "im_a.tif", "im_b.tif", "--mm-per-px", "0.1", "--figures", "-o", out]
    done = subprocess.run(
        [sys.executable, "-m", "rtpiv", *words],
        cwd=folder,
        env=os.environ | environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == DONE, done.stderr
    assert "Traceback" not in done.stderr
    return pictures_of(folder / out)


def pictures_of(folder):
    """Digest of every picture that is drawn by Matplotlib, which writes no date into them."""
    found = {file.name: sha256(file.read_bytes()).hexdigest() for file in folder.glob("*.png")}
    assert found
    return found


@pytest.mark.slow
@pytest.mark.draws
def test_a_command_draws_the_same_pictures_as_a_script_that_keeps_its_settings(day, plain, tmp_path):
    assert command(day, str(tmp_path / "out"), UNUSUAL) == pictures_of(plain)
    vectors = [read_vectors(folder / "vectors.nc").fields["u"] for folder in (tmp_path / "out", plain)]
    np.testing.assert_array_equal(*vectors)


@pytest.mark.draws
@pytest.mark.parametrize("values", [[], [np.nan, np.nan], [0.0, -1.0], [0.0, 2.0], [1e-3, 1e3]], ids=str)
def test_a_logarithmic_axis_of_any_values_can_be_drawn(tmp_path, values):
    figure, axes = bare_figure(3.0, 2.0)
    axes.plot(np.arange(len(values)), values)
    log_scale(axes.yaxis)
    log_scale(axes.xaxis, base=2)
    figure.savefig(tmp_path / "a.png")
    assert axes.get_yscale() == ("log" if any(value > 0.0 for value in values) else "linear")
