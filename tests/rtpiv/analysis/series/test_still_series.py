"""A wall that nobody told, in a series: found once in raw frames, and given to every pair and to the ensemble."""

import numpy as np
import pytest
import tifffile

from ground.map_file import load_arrays
from piv.files.vector_file import read_vectors
from rtpiv.analysis.series.shared_file import SharedFile
from rtpiv.analysis.series.still_frames import KIND, load_still
from rtpiv.command_line.cli import DONE, main
from tests.piv.preprocessing.test_still_light import SHAPE, WALL, over_a_wall

MM = 0.04
TOLD = ("--mm-per-px", str(MM), "--dt-us", "200", "--workers", "1", "--prepare", "sliding-minimum")


@pytest.fixture(scope="module")
def day(tmp_path_factory):
    folder, rng = tmp_path_factory.mktemp("day"), np.random.default_rng(4)
    for number in range(10):
        light = rng.uniform(0.7, 1.3)
        for pulse, frame in enumerate(over_a_wall(number, (light, light))):
            tifffile.imwrite(folder / f"im{2 * number + pulse:04d}.tif", frame)
    return folder


def kept(out):
    """Mask of a series."""
    header, _ = load_arrays(out / "still.npz", KIND)
    return load_still(SharedFile(out / "still.npz", header["key"]))


@pytest.mark.slow
@pytest.mark.usefixtures("no_mean_page")
def test_what_flickers_in_both_pulses_has_no_vector_and_no_mean(day, tmp_path):
    out = tmp_path / "out"
    assert main(["mean", str(day), *TOLD, "--ensemble", "16", "-o", str(out)]) == DONE
    still = kept(out)
    assert still.shape == SHAPE
    assert still[WALL + 2 :].mean() > 0.99
    assert not still[: WALL - 16].any()
    found = read_vectors(out / "chunks" / "00000.nc")
    solid = found.y_mm < (SHAPE[0] - 1) / 2 * MM - MM * WALL
    assert solid.sum() > 5
    assert (found.fields["flag"][:, solid] == 4).all()
    assert np.isnan(found.fields["u"][:, solid]).all()
    assert (found.fields["flag"][:, ~solid][:, 6:] == 0).mean() > 0.95
    assert "4 still" in found.attributes["flag_meanings"]
    for name in ("mean.nc", "mean_ensemble.nc"):
        found = read_vectors(out / name)
        solid = found.y_mm < (SHAPE[0] - 1) / 2 * MM - MM * WALL
        assert solid.any()
        assert not found.fields["chc"][:, solid].any(), name
        assert found.fields["chc"][:, ~solid][:, 4:].mean() > 0.95, name
