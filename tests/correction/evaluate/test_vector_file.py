"""Vectors on disk: read back by a reader of its own, y up, units said."""

import numpy as np
import pytest
from scipy.io import netcdf_file

from correction.evaluate.vector_file import write_netcdf, write_traced, write_vtk
from correction.evaluate.velocity_route import PlaneVectors
from correction.fitted.vector_map_sigma import VectorMapSigma
from correction.grid import PlaneGrid
from piv.correlation.vector_field import VectorField, VectorFlag

GRID = PlaneGrid((-10.0, 5.0), 0.1, (100, 120))


def a_field():
    """Three rows of four vectors, one of them masked."""
    shape = (3, 4)
    values = np.arange(12.0).reshape(shape)
    flags = np.zeros(shape, np.uint8)
    flags[0, 0], flags[1, 2] = VectorFlag.MASKED, VectorFlag.REPLACED
    u = np.where(flags == VectorFlag.MASKED, np.nan, values)
    return VectorField(
        x_px=np.array([15.5, 31.5, 47.5, 63.5]),
        y_px=np.array([15.5, 31.5, 47.5]),
        u_px=u,
        v_px=2.0 * u,
        flags=flags,
        peak_ratio=values + 1.0,
        correlation=values / 12.0,
        sigma_u_px=0.01 * values,
        sigma_v_px=0.02 * values,
        valid_fraction=np.ones(shape),
        window_px=32,
        step_px=16,
        nan_pixels=0,
    )


@pytest.fixture
def field():
    return a_field()


def test_netcdf_holds_mm_with_y_up(tmp_path, field):
    path = tmp_path / "vectors.nc"
    write_netcdf(path, field, GRID, {"scene_hash": "abc"})
    with netcdf_file(path, mmap=False) as file:
        assert file.dimensions == {"y": 3, "x": 4, "t": 1}
        assert np.allclose(file.variables["x"][:], -10.0 + 0.1 * field.x_px)
        assert np.allclose(file.variables["y"][:], 5.0 - 0.1 * field.y_px[::-1])
        u, v = file.variables["u"][::-1, :, 0], file.variables["v"][::-1, :, 0]
        assert np.allclose(u, 0.1 * field.u_px, equal_nan=True)
        assert np.allclose(v, -0.1 * field.v_px, equal_nan=True)
        assert file.variables["u"].units == b"mm"
        assert file.variables["chc"][::-1, :, 0].tolist() == field.valid.astype(int).tolist()
        assert file.variables["mask"][-1, 0, 0] == 1
        assert file.scene_hash == b"abc"
        assert file.Conventions == b"CF-1.8"
    assert [p.name for p in tmp_path.iterdir()] == ["vectors.nc"]


def test_the_map_s_sigmas_and_the_route_stand_beside_the_vectors(tmp_path, field):
    place, way = (scale * np.ones((3, 4, 2)) * (1.0, 2.0) for scale in (0.1, 0.01))
    place[0, 0] = np.nan
    traced = np.arange(12).reshape(3, 4) > 8
    write_netcdf(tmp_path / "vectors.nc", field, GRID, {}, VectorMapSigma(place, way), traced)
    with netcdf_file(tmp_path / "vectors.nc", mmap=False) as file:
        read = {
            name: variable[::-1, :, 0] for name, variable in file.variables.items() if variable.shape == (3, 4, 1)
        }
        assert file.variables["map_sigma_x"].units == b"mm"
    for name, expected in (("u", 0.001), ("v", 0.002), ("x", 0.01), ("y", 0.02)):
        assert read[f"map_sigma_{name}"][2, 3] == pytest.approx(expected)
    assert np.isnan(read["map_sigma_x"][0, 0])
    assert np.array_equal(read["route"], traced)


def test_traced_vectors_are_a_list(tmp_path):
    values = np.arange(6.0).reshape(3, 2)
    write_traced(
        tmp_path / "t.nc",
        PlaneVectors(values, 2 * values, 3 * values, 4 * values, np.array([0, 1, 1], np.uint16)),
        {},
    )
    with netcdf_file(tmp_path / "t.nc", mmap=False) as file:
        assert file.dimensions == {"vector": 3}
        assert file.variables["v"][:].tolist() == [2.0, 6.0, 10.0]
        assert file.variables["sigma_u"][:].tolist() == [0.0, 6.0, 12.0]
        assert file.variables["branch"][:].tolist() == [0, 1, 1]


def test_xarray_and_pivpy_read_it(tmp_path, field):
    xarray = pytest.importorskip("xarray", reason="xarray is not installed; the layout is checked with scipy")
    write_netcdf(tmp_path / "vectors.nc", field, GRID, {"scene_hash": "abc"})
    data = xarray.open_dataset(tmp_path / "vectors.nc", engine="scipy")
    assert dict(data.sizes) == {"y": 3, "x": 4, "t": 1}
    assert data.u.attrs["units"] == "mm"
    assert float(data.v.isel(t=0).sel(x=-10.0 + 4.75, y=5.0 - 3.15, method="nearest")) == pytest.approx(-1.2)
    pytest.importorskip("pivpy.pivpy", reason="PIVPy is not installed")
    assert "w" in data.piv.vorticity()


def test_it_is_a_velocity_only_where_the_time_is_known(tmp_path, field):
    sigma = VectorMapSigma(*np.ones((2, 3, 4, 2)))
    write_netcdf(tmp_path / "way.nc", field, GRID, {}, sigma)
    write_netcdf(tmp_path / "speed.nc", field, GRID, {}, sigma, dt_s=0.25)
    with (
        netcdf_file(tmp_path / "way.nc", mmap=False) as way,
        netcdf_file(tmp_path / "speed.nc", mmap=False) as speed,
    ):
        assert (way.delta_t, speed.delta_t) == (0.0, 0.25)
        for name in ("u", "v", "sigma_u", "sigma_v", "map_sigma_u", "map_sigma_v"):
            slow, fast = way.variables[name], speed.variables[name]
            assert (slow.units, fast.units) == (b"mm", b"mm/s")
            assert np.array_equal(fast[:], slow[:] / 0.25, equal_nan=True)
        assert (way.variables["u"].standard_name, way.variables["v"].standard_name) == (
            b"u_displacement", b"v_displacement")  # fmt: skip
        assert (speed.variables["u"].standard_name, speed.variables["v"].standard_name) == (
            b"u_velocity", b"v_velocity")  # fmt: skip
        assert speed.variables["x"].units == speed.variables["map_sigma_x"].units == b"mm"
        assert np.array_equal(way.variables["map_sigma_x"][:], speed.variables["map_sigma_x"][:])
    write_vtk(tmp_path / "speed.vtk", field, GRID, 0.25)
    assert "VECTORS velocity double" in (tmp_path / "speed.vtk").read_text()


def test_vtk_lists_points_and_vectors(tmp_path, field):
    path = tmp_path / "vectors.vtk"
    write_vtk(path, field, GRID)
    lines = path.read_text().splitlines()
    assert lines[0].startswith("# vtk DataFile")
    assert "DIMENSIONS 4 3 1" in lines
    points = lines[lines.index("POINTS 12 double") + 1 :][:12]
    assert [float(x) for x in points[5].split()] == pytest.approx([-10.0 + 3.15, 5.0 - 3.15, 0.0])
    vectors = lines[lines.index("VECTORS displacement double") + 1 :][:12]
    assert vectors[0].split()[0] == "nan"
    assert [float(x) for x in vectors[5].split()] == pytest.approx([0.5, -1.0, 0.0])
