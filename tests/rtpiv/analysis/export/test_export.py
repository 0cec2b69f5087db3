"""Vectors in other people's formats, opened by readers that are not ours."""

import meshio
import numpy as np
import pytest
from scipy.io import loadmat, netcdf_file

from piv.files.vector_file import read_vectors, write_vectors
from rtpiv.command_line.cli import DONE, USAGE, main
from tests.rtpiv.analysis.test_pair_vectors import a_field, of_pair

X, Y, T = np.array([1.0, 2.0, 3.0, 4.0]), np.array([-1.0, 0.0, 1.0]), np.array([0.0, 0.1])


def written(path, order=("t", "y", "x"), **more):
    """A file as a chunk of a series has it; u = 100 t + 10 y + x, and nothing in one place."""
    t, y, x = np.meshgrid(np.arange(2), np.arange(3), np.arange(4), indexing="ij")
    u = 100.0 * t + 10.0 * y + x
    u[0, 1, 2] = np.nan
    places = [("t", "y", "x").index(name) for name in order]
    with netcdf_file(path, "w") as file:
        for name, values in (("t", T), ("y", Y), ("x", X)):
            file.createDimension(name, len(values))
            one = file.createVariable(name, "f8", (name,))
            one[:] = values
        for name, values in (("u", u), ("v", -u)):
            one = file.createVariable(name, "f8", order)
            one[:] = values.transpose(places)
            one.units = "m s-1"
        one = file.createVariable("delta_t", "f8", ("t",))
        one[:] = [1e-3, 2e-3]
        one.units = "s"
        for name, values in more.items():
            setattr(file, name, values)
    return path


def exported(source, to, out):
    return main(["export", str(source), "--to", to, "-o", str(out)])


@pytest.mark.parametrize("order", [("t", "y", "x"), ("y", "x", "t")])
def test_both_orders_are_one_table(tmp_path, order):
    table = read_vectors(written(tmp_path / "a.nc", order))
    assert table.fields["u"].shape == (2, 3, 4)
    assert table.fields["u"][1, 2, 3] == 123.0
    assert not table.measured[0, 1, 2]
    assert table.measured.sum() == 23
    assert np.all(table.everything["delta_t"][1] == 2e-3)


def test_matlab_gets_arrays_with_their_units(tmp_path):
    source = written(tmp_path / "a.nc", title='odd "title"\n')
    assert exported(source, "matlab", tmp_path / "out") == DONE
    found = loadmat(tmp_path / "out" / "a.mat", squeeze_me=True)
    assert found["u"].shape == (3, 4, 2)
    assert found["u"][2, 3, 1] == 123.0
    assert np.isnan(found["v"][1, 2, 0])
    assert str(found["units"]["u"]) == "m s-1"
    assert str(found["title"]) == "odd title"
    np.testing.assert_array_equal(found["y_mm"], Y)


def test_paraview_gets_a_series_of_grids(tmp_path):
    assert (
        main(["export", str(written(tmp_path / "a.nc")), "--to", "paraview", "-o", str(tmp_path / "out")]) == DONE
    )
    second = meshio.read(tmp_path / "out" / "a_00001.vtk")
    place = int(np.flatnonzero((second.points == (4.0, 1.0, 0.0)).all(axis=1))[0])
    np.testing.assert_array_equal(second.point_data["velocity"][place], (123.0, -123.0, 0.0))
    assert len(second.points) == 12
    first = meshio.read(tmp_path / "out" / "a_00000.vtk")
    assert np.isnan(first.point_data["u"]).sum() == 1


def test_tecplot_gets_a_zone_a_time_without_nan(tmp_path):
    assert (
        main(["export", str(written(tmp_path / "a.nc")), "--to", "tecplot", "-o", str(tmp_path / "out")]) == DONE
    )
    text = (tmp_path / "out" / "a.dat").read_text()
    zones = text.split("ZONE")[1:]
    assert [zone.split(",")[1].strip() for zone in zones] == ["I=4", "I=4"]
    names = [name.strip(' "') for name in text.splitlines()[1].removeprefix("VARIABLES =").split(",")]
    assert names == ["x [mm]", "y [mm]", "u [m s-1]", "v [m s-1]", "delta_t [s]", "measured"]
    numbers = np.loadtxt(zones[0].splitlines()[1:])
    assert np.isfinite(numbers).all()
    np.testing.assert_array_equal(numbers[6], [3.0, 0.0, 0.0, 0.0, 1e-3, 0.0])
    np.testing.assert_array_equal(numbers[1][:3], [2.0, -1.0, 1.0])


@pytest.mark.parametrize(
    ("to", "missing"), [("matlab", "NaN"), ("paraview", "NaN"), ("tecplot", "0 in them and in measured")]
)
def test_what_was_written_is_said_with_units_and_gaps(tmp_path, capsys, to, missing):
    assert exported(written(tmp_path / "a.nc"), to, tmp_path / "out") == DONE
    said = " ".join(capsys.readouterr().out.split())
    assert "u [m s-1], v [m s-1], delta_t [s], over x, y [mm] and t [s]" in said
    assert f"where nothing was measured stands {missing}" in said


def test_a_missing_file_and_a_folder_are_called_by_their_name(tmp_path, capsys):
    written(tmp_path / "vectors.nc")
    for to in ("matlab", "netcdf"):
        assert exported(tmp_path / "none.nc", to, tmp_path / "o") == USAGE
        assert "none.nc: is not there" in capsys.readouterr().err
        assert exported(tmp_path, to, tmp_path / "o") == USAGE
        assert "is a folder; name files in it, such as vectors.nc" in capsys.readouterr().err
    (tmp_path / "empty").mkdir()
    assert exported(tmp_path / "empty", "matlab", tmp_path / "o") == USAGE
    assert "is a folder without files that can be exported" in capsys.readouterr().err


def test_what_evaluate_writes_goes_through(tmp_path):
    write_vectors(tmp_path / "pair.nc", of_pair(a_field()))
    table = read_vectors(tmp_path / "pair.nc")
    assert table.fields["u"].shape[0] == 1
    assert table.measured.any()


def test_what_is_none_is_one_sentence(tmp_path, capsys):
    whole = written(tmp_path / "a.nc").read_bytes()
    rng = np.random.default_rng(1)
    for case in range(60):
        damaged = bytearray(whole)
        for place in rng.integers(0, len(whole), 12):
            damaged[place] = rng.integers(0, 256)
        (tmp_path / "b.nc").write_bytes(
            bytes(damaged[: int(rng.integers(0, len(whole)))] if case % 2 else damaged)
        )
        assert main(["export", str(tmp_path / "b.nc"), "--to", "matlab", "-o", str(tmp_path / "o")]) in (
            DONE,
            USAGE,
        )
    for path in (tmp_path / "none.nc", tmp_path):
        assert exported(path, "matlab", tmp_path / "o") == USAGE
    assert "Traceback" not in capsys.readouterr().err


def test_files_of_one_name_are_called_after_their_folders(tmp_path, capsys):
    for folder in ("pair_1", "pair_2"):
        (tmp_path / folder).mkdir()
        written(tmp_path / folder / "vectors.nc")
    both = [str(tmp_path / folder / "vectors.nc") for folder in ("pair_1", "pair_2")]
    assert main(["export", *both, "--to", "matlab", "-o", str(tmp_path / "out")]) == DONE
    assert {file.name for file in (tmp_path / "out").glob("[!.]*")} == {"pair_1_vectors.mat", "pair_2_vectors.mat"}
    assert main(["export", both[0], both[0], "--to", "matlab", "-o", str(tmp_path / "out")]) == USAGE
    assert "is named twice" in capsys.readouterr().err


def test_vectors_are_not_exported_to_what_they_are(tmp_path, capsys):
    assert exported(written(tmp_path / "a.nc"), "netcdf", tmp_path / "out") == USAGE
    assert "a.nc: is NetCDF already" in " ".join(capsys.readouterr().err.split())


def test_names_with_dots_stay_apart_and_results_of_others_are_kept(tmp_path, capsys):
    places = [written(tmp_path / name) for name in ("run.1.nc", "run.2.nc")]
    out = tmp_path / "out"
    for to, ending in (("matlab", "mat"), ("tecplot", "dat"), ("csv", "csv")):
        words = ["--to", to, "-o", str(out)]
        assert main(["export", *map(str, places), *words]) == DONE
        assert (out / f"run.1.{ending}").exists()
        assert (out / f"run.2.{ending}").exists()
    (tmp_path / "other").mkdir()
    other = written(tmp_path / "other" / "run.2.nc")
    (out / "run.3.csv").write_text("by hand")
    before = {file.name: file.read_bytes() for file in out.iterdir()}
    for source in (other, written(tmp_path / "run.3.nc")):
        assert main(["export", str(source), "--to", "csv", "-o", str(out)]) == USAGE
        assert "made from something else; give another folder with -o, or --overwrite" in capsys.readouterr().err
    assert {file.name: file.read_bytes() for file in out.iterdir()} == before
    assert main(["export", str(places[1]), *words]) == DONE  # the same once more
    assert main(["export", str(other), *words, "--overwrite"]) == DONE
    assert main(["export", str(places[1]), *words]) == USAGE
