"""How far glass and target are from the sheet, from measured positions."""

import pytest

from daq.bench.bench_file import load_bench
from daq.bench.guards import sheet_clearance_mm
from tests.daq.small_bench import write_bench


@pytest.fixture
def bench(tmp_path):
    return load_bench(write_bench(tmp_path))


@pytest.mark.parametrize(("glass_z", "target_z", "free"), [
    (0.0, -30.0, 0.0),  # the near ball touches the plane
    (4.0, -30.0, 4.0),
    (4.0, -3.0, 3.0),
    (4.0, 0.0, 0.0),  # the target hangs in the sheet
    (4.0, 8.0, 3.0),  # in front of it, less the thickness of the board
    (-1.0, -30.0, -1.0),  # the ball cuts the sheet
    (-25.0, -30.0, -25.0),  # by its middle
])  # fmt: skip
def test_the_nearest_counts(bench, glass_z, target_z, free):
    places = bench.home_mm | {"glass_z": glass_z, "target_z": target_z}
    assert sheet_clearance_mm(bench, places) == pytest.approx(free)
