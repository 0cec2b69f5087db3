"""Vectors of pairs on disk: read back by readers of others, y up, units said, one pair as a series of one."""

from dataclasses import replace

import meshio
import numpy as np
import pytest
from scipy.io import netcdf_file

from correction.evaluate.particle_tracks import PlaneVectors
from correction.fitted.map_sigma import VectorMapSigma
from correction.grid import PlaneGrid
from piv.correlation.vector_field import VectorField, VectorFlag
from piv.correlation.windows import WindowGrid
from piv.errors import VectorFileError
from piv.files.vector_file import read_vectors, vectors_netcdf, write_list, write_vectors, write_vtk
from rtpiv.analysis.pairs.pair_vectors import PairResult, columns_of, quality_of, read_chunk, vectors_of_pairs

GRID = PlaneGrid((-10.0, 5.0), 0.1, (100, 120))
WINDOWS = WindowGrid(np.array([0, 16, 32]), np.array([0, 16, 32, 48]), 32, 16)


def a_field():
    """Three rows of four vectors, one of them masked."""
    shape = (3, 4)
    values = np.arange(12.0).reshape(shape)
    flags = np.zeros(shape, np.uint8)
    flags[0, 0], flags[1, 2] = VectorFlag.MASKED, VectorFlag.REPLACED
    u = np.where(flags == VectorFlag.MASKED, np.nan, values)
    return VectorField(
        x_px=WINDOWS.x_px,
        y_px=WINDOWS.y_px,
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


def of_pair(field, dt_s=None, *more, **about):
    """A pair as a series of one; `more` are sigmas of the map."""
    parts = [field.total_sigma_px, *(each.displacement_px for each in more[:1] if each is not None)]
    total = np.sqrt(np.square(np.nan_to_num(parts)).sum(axis=0))
    quality = quality_of(field, GRID, np.where(np.isnan(parts[0]), np.nan, total), *more, dt_s=dt_s)
    return vectors_of_pairs([PairResult("a, b", field, dt_s)], WINDOWS, GRID, about, quality)


def test_netcdf_holds_mm_with_y_up(tmp_path, field):
    path = tmp_path / "vectors.nc"
    write_vectors(path, of_pair(field, scene_hash="abc"))
    with netcdf_file(path, mmap=False) as file:
        assert file.dimensions == {"t": 1, "y": 3, "x": 4}
        assert np.allclose(file.variables["x"][:], -10.0 + 0.1 * field.x_px)
        assert np.allclose(file.variables["y"][:], 5.0 - 0.1 * field.y_px[::-1])
        u, v = file.variables["u"][0, ::-1], file.variables["v"][0, ::-1]
        assert np.allclose(u, 0.1 * field.u_px, equal_nan=True)
        assert np.allclose(v, -0.1 * field.v_px, equal_nan=True)
        assert file.variables["u"].units == b"mm"
        assert file.variables["chc"][0, ::-1].tolist() == field.valid.astype(int).tolist()
        assert file.variables["flag"][0, -1, 0] == VectorFlag.MASKED
        assert (file.rtpiv_schema, file.pivpy_schema_version) == (2, 1)
        assert file.scene_hash == b"abc"
        assert file.Conventions == b"CF-1.8"
    assert [p.name for p in tmp_path.iterdir()] == ["vectors.nc"]


def test_what_is_written_is_read(tmp_path, field):
    """One pair, and a series with one that has no vectors: the same dataset comes back, to the last bit."""
    series = [
        PairResult("f_000000", field, 0.25, 0.01, 0.0),
        PairResult("f_000002", "a flash failed", 0.25, None, 0.1),
    ]
    for vectors in (of_pair(field, 0.25), vectors_of_pairs(series, WINDOWS, GRID, {})):
        write_vectors(tmp_path / "v.nc", vectors)
        for found in (read_vectors(tmp_path / "v.nc"), read_vectors(vectors_netcdf(vectors))):
            assert found.x_mm.tobytes() == vectors.x_mm.tobytes()
            assert set(found.fields) == set(vectors.fields)
            assert set(found.by_time) == set(vectors.by_time)
            for name, values in vectors.fields.items():
                assert np.array_equal(found.fields[name], values.astype(found.fields[name].dtype), equal_nan=True)
            assert found.units["u"] == "m s-1"
            assert (found.kind, found.time_unit) == ("velocity", vectors.time_unit)
    chunk = read_chunk(vectors_netcdf(vectors))
    assert [field.failure for field in chunk.fields] == ["", "a flash failed"]
    assert (chunk.window_px, chunk.step_px, chunk.px_per_mm) == (32, 16, 10.0)
    assert "3 x 4" in repr(vectors)
    assert "u [m s-1]" in vectors._repr_html_()


def test_vectors_before_the_noise_filter_come_back_with_v_up(field):
    rough = np.stack((field.u_px + 0.1, field.v_px - 0.2), axis=-1)
    unfiltered = {"unfiltered_sigma_px": 0.03 * field.u_px, "unfiltered_steady_px": 0.04 * field.u_px}
    sides = np.where(np.arange(4) < 2, 32, 16) * np.ones((3, 1), np.int64)
    known = replace(field, unfiltered_px=rough, side_px=sides, **unfiltered)
    pairs = [PairResult("f_000000", known, 0.25), PairResult("f_000002", "a flash failed", 0.25)]
    vectors = vectors_of_pairs(pairs, WINDOWS, GRID, {})
    assert vectors.units["unfiltered_u"] == vectors.units["unfiltered_sigma"] == "m s-1"
    first, failed = read_chunk(vectors_netcdf(vectors)).fields
    u = field.u_px[::-1]
    expected = 4e-4 * np.stack((u + 0.1, -(2.0 * u - 0.2), 0.03 * u, 0.04 * u), axis=-1)
    np.testing.assert_allclose(first.unfiltered_m_s, expected, rtol=1e-6)
    assert first.is_usual.tolist() == [[True, True, False, False]] * 3
    assert np.isnan(failed.unfiltered_m_s).all()
    # Without the filter, as in files of older versions, there are none.
    old = vectors_of_pairs([PairResult("f_000000", field, 0.25)], WINDOWS, GRID, {})
    assert not any(name.startswith("unfiltered") or name == "usual_window" for name in old.fields)
    same = read_chunk(vectors_netcdf(old)).fields[0]
    assert (same.unfiltered_m_s, same.is_usual) == (None, None)


def test_the_map_s_sigmas_stand_beside_the_vectors(tmp_path, field):
    place, way = (scale * np.ones((3, 4, 2)) * (1.0, 2.0) for scale in (0.1, 0.01))
    place[0, 0] = np.nan
    write_vectors(tmp_path / "vectors.nc", of_pair(field, None, VectorMapSigma(place, way, way)))
    with netcdf_file(tmp_path / "vectors.nc", mmap=False) as file:
        read = {
            name: variable[0, ::-1] for name, variable in file.variables.items() if variable.shape == (1, 3, 4)
        }
        assert file.variables["map_sigma_x"].units == b"mm"
    for name, expected in (("u", 0.001), ("v", 0.002), ("x", 0.01), ("y", 0.02)):
        assert read[f"map_sigma_{name}"][2, 3] == pytest.approx(expected)
    assert np.isnan(read["map_sigma_x"][0, 0])


@pytest.mark.parametrize(("dt_s", "unit", "scale"), [(0.25, b"s-1", 4.0), (None, b"1", 1.0)])
def test_rates_are_those_of_the_flow_with_a_sigma(tmp_path, field, dt_s, unit, scale):
    """Turned by 0.02 counter-clockwise between the frames."""
    x, down = np.meshgrid(field.x_px, field.y_px)
    turned = replace(field, u_px=0.02 * down, v_px=-0.02 * x, flags=np.zeros((3, 4), np.uint8))
    turned = replace(turned, sigma_u_px=np.full((3, 4), 0.1), sigma_v_px=np.full((3, 4), 0.1))
    write_vectors(tmp_path / "vectors.nc", of_pair(turned, dt_s))
    with netcdf_file(tmp_path / "vectors.nc", mmap=False) as file:
        read = {name: each[0, 1, 1:3] for name, each in file.variables.items() if each.shape == (1, 3, 4)}
        assert file.variables["vorticity"].units == file.variables["sigma_shear"].units == unit
    np.testing.assert_allclose(read["vorticity"], 0.04 * scale, rtol=1e-5)
    np.testing.assert_allclose(read["swirling_strength"], 0.02 * scale, rtol=1e-5)
    np.testing.assert_allclose(read["divergence"], 0.0, atol=1e-6)
    alike = np.exp(-(32.0**2) / (4.0 * 16.0**2))  # of neighbours 32 px apart, windows of 32 px
    sigma = 0.1 * np.sqrt(2.0 * (1.0 - alike)) / 32.0 * np.sqrt(2.0) * scale
    np.testing.assert_allclose(read["sigma_vorticity"], sigma, rtol=1e-5)


def test_traced_vectors_are_a_list(tmp_path):
    values = np.arange(6.0).reshape(3, 2)
    traced = PlaneVectors(values, 2 * values, 3 * values, 4 * values, np.array([0, 1, 1], np.uint16))
    write_list(tmp_path / "t.nc", *columns_of(traced, None), {})
    with netcdf_file(tmp_path / "t.nc", mmap=False) as file:
        assert file.dimensions == {"vector": 3}
        assert file.variables["v"][:].tolist() == [2.0, 6.0, 10.0]
        assert file.variables["sigma_u"][:].tolist() == [0.0, 6.0, 12.0]
        assert file.variables["branch"][:].tolist() == [0, 1, 1]
        assert file.variables["u"].units == file.variables["x"].units == b"mm"
    with pytest.raises(VectorFileError, match="lie on none"):
        read_vectors(tmp_path / "t.nc")


@pytest.mark.slow  # three seconds to import both
def test_xarray_and_pivpy_read_it(tmp_path, field):
    xarray = pytest.importorskip("xarray")
    write_vectors(tmp_path / "vectors.nc", of_pair(field, scene_hash="abc"))
    with xarray.open_dataset(tmp_path / "vectors.nc") as data:
        assert dict(data.sizes) == {"t": 1, "y": 3, "x": 4}
        assert data.u.attrs["units"] == "mm"
        there = data.v.isel(t=0).sel(x=-10.0 + 4.75, y=5.0 - 3.15, method="nearest")
        assert float(there) == pytest.approx(-1.2)
    pivpy = pytest.importorskip("pivpy.io", reason="PIVPy is not installed; its reader asks for less than xarray")
    data = pivpy.NetCDFReader().read(tmp_path / "vectors.nc")
    assert data.u.dims == ("y", "x", "t")
    assert "w" in data.piv.vorticity()


def test_a_file_of_schema_1_is_read(tmp_path, field):
    """A pair lay as (y, x, t) there, in mm/s."""
    with netcdf_file(tmp_path / "old.nc", "w", version=2) as file:
        for name, values, unit in (
            ("y", np.arange(3.0), "mm"),
            ("x", np.arange(4.0), "mm"),
            ("t", np.zeros(1), "frame"),
        ):
            file.createDimension(name, len(values))
            one = file.createVariable(name, "f8", (name,))
            one[:], one.units = values, unit
        for name in "uv":
            one = file.createVariable(name, "f8", ("y", "x", "t"))
            one[:], one.units = field.u_px[..., None], "mm/s"
    found = read_vectors(tmp_path / "old.nc")
    assert np.array_equal(found.fields["u"][0], field.u_px, equal_nan=True)
    assert (found.units["u"], found.time_unit) == ("mm/s", "frame")


def test_it_is_a_velocity_only_where_the_time_is_known(tmp_path, field):
    sigma = VectorMapSigma(*np.ones((3, 3, 4, 2)))
    way, speed = of_pair(field, None, sigma), of_pair(field, 0.25, sigma)
    assert (way.attributes["delta_t"], speed.attributes["delta_t"]) == (0.0, 0.25)
    for name in ("u", "v", "sigma_u", "sigma_v", "map_sigma_u", "map_sigma_v"):
        assert (way.units[name], speed.units[name]) == ("mm", "m s-1")
        assert np.allclose(speed.fields[name], 1e-3 * way.fields[name] / 0.25, equal_nan=True)
    assert speed.units["map_sigma_x"] == "mm"
    assert np.array_equal(way.fields["map_sigma_x"], speed.fields["map_sigma_x"])
    for vectors, kind in ((way, b"displacement"), (speed, b"velocity")):
        write_vectors(tmp_path / "v.nc", vectors)
        with netcdf_file(tmp_path / "v.nc", mmap=False) as file:
            assert file.variables["u"].standard_name == b"u_" + kind
            assert file.variables["v"].standard_name == b"v_" + kind


def test_vtk_lists_points_and_vectors(tmp_path, field):
    for dt_s, name, unit in ((None, "displacement", 1.0), (0.25, "velocity", 4e-3)):
        (path,) = write_vtk(tmp_path / "vectors.vtk", of_pair(field, dt_s))
        found = meshio.read(path)
        place = int(np.argmin(np.linalg.norm(found.points - (-10.0 + 3.15, 5.0 - 3.15, 0.0), axis=1)))
        assert found.point_data[name][place] == pytest.approx(unit * np.array((0.5, -1.0, 0.0)))
        assert np.isnan(found.point_data[name][:, 0]).sum() == 1
        assert found.point_data["flag"].max() == VectorFlag.REPLACED
