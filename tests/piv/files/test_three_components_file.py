"""Files of vectors with w: ParaView gets the third component, and one camera's vectors stay in the plane."""

import numpy as np
import pytest

from piv.files.vector_file import Vectors, read_vectors, vectors_netcdf, write_vtk


@pytest.mark.parametrize("has_w", [True, False])
def test_the_third_component_is_in_the_vectors(tmp_path, has_w):
    names = "uvw" if has_w else "uv"
    fields = {name: np.full((1, 2, 2), value) for name, value in zip(names, (1.5, -2.0, 0.25), strict=False)}
    vectors = Vectors(np.arange(2.0), np.arange(2.0), np.zeros(1), fields, units=dict.fromkeys(names, "m s-1"))
    lines = write_vtk(tmp_path / "a.vtk", vectors)[0].read_text().splitlines()
    first = lines.index("VECTORS velocity double") + 1
    assert lines[first : first + 4] == ["1.5 -2 0.25" if has_w else "1.5 -2 0"] * 4
    assert set(read_vectors(vectors_netcdf(vectors)).fields) == set(names)
