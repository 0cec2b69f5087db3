"""The tour of examples/ runs, shows what it says, and needs nothing but the faces."""

import ast
import runpy
from pathlib import Path

import pytest

TOUR = Path(__file__).resolve().parents[2] / "examples" / "tour.py"


@pytest.fixture
def tour():
    import matplotlib
    from matplotlib import pyplot as plt  # here: all processes of the tests would wait for it

    matplotlib.use("agg")
    yield runpy.run_path(str(TOUR))["tour"]
    plt.close("all")


@pytest.mark.slow
def test_from_scene_to_pictures(tour, tmp_path, capsys):
    tour(tmp_path)
    said = capsys.readouterr().out
    found = next(line for line in said.splitlines() if line.startswith("far.z"))
    assert abs(float(found.split()[1]) - 75.0) < 1.5
    assert "of the plane is recovered" in said
    assert (tmp_path / "tour.png").stat().st_size > 50_000


def test_it_takes_names_from_faces_alone():
    imported = {
        alias.name
        for node in ast.walk(ast.parse(TOUR.read_text(encoding="utf-8")))
        if isinstance(node, ast.Import)
        for alias in node.names
    }
    assert {"tracer", "correction", "sim"} <= imported
    taken = [node.module for node in ast.walk(ast.parse(TOUR.read_text())) if isinstance(node, ast.ImportFrom)]
    assert taken == ["pathlib"]
    assert len(TOUR.read_text().splitlines()) < 70
