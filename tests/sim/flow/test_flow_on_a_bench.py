"""The simulated bench shows a flow: at true places, lit by flashes, with its truth for whoever scores the run."""

import numpy as np
import pytest
import yaml

from daq.bench.bench_file import load_bench
from ground.config import Document, validate
from sim.bench import SimulatedBench
from sim.flow.table import FlowTable
from sim.prepared_pairs import main as prepare_main
from tests.daq.small_bench import write_bench
from tracer.errors import SceneError

MS = 1_000_000
FLOW = "flow: {field: shear, parameters: {velocity_mm_s: [0.0, 300.0, 0.0]}, prepared: ready}"

RENDERED = FLOW.replace(", prepared: ready", "")


@pytest.fixture
def flow_bench(tmp_path):
    made = []

    def start(simulation=RENDERED):
        bench = SimulatedBench(load_bench(write_bench(tmp_path, 120, simulation)), "flow")
        made.append(bench)
        return bench

    yield start
    for bench in made:
        bench.close()


def test_exposures_show_what_was_lit_and_the_truth_is_told_apart(flow_bench):
    bench = flow_bench()
    world = bench.world
    for k in range(3):
        bench.seed(k > 0)
        world.lit.flash(0, 100 * k * MS)
        world.lit.flash(1, 100 * k * MS + MS // 2)
    dark = world.expose(0, 50 * MS, 60 * MS)
    still = world.expose(1, 0, MS // 4)
    first, second = world.expose(2, 100 * MS, 100 * MS + 1), world.expose(3, 100 * MS + 1, 101 * MS)
    assert dark.max() < 60
    assert still[:30].mean() == pytest.approx(37.0, abs=0.5)  # haze over the offset: not seeded yet
    assert first[:30].mean() > 38.0
    assert np.corrcoef(first.ravel(), second.ravel())[0, 1] > 0.3
    truth = bench.secrets()
    told = validate(Document(load_bench.__module__, yaml.safe_load(truth["flow_truth.yaml"]), {(): 1}), FlowTable)
    assert told.flow(0).base.velocity_mm_s == (0.0, 300.0, 0.0)
    assert "position_mm" in truth["truth.yaml"]


def test_the_flow_is_seen_from_where_the_camera_stands(flow_bench, monkeypatch):
    world = flow_bench().world
    world.lit.flash(0, 0)
    world.lit.flash(0, 100 * MS)
    here = world.expose(0, 100 * MS, 101 * MS)
    true_mm = world.true_mm()
    monkeypatch.setattr(world, "true_mm", lambda: {**true_mm, "rail_z": true_mm["rail_z"] + 50.0})
    assert not np.array_equal(here, world.expose(1, 100 * MS, 101 * MS))
    monkeypatch.setattr(world, "true_mm", lambda: true_mm)
    np.testing.assert_array_equal(here, world.expose(2, 100 * MS, 101 * MS))


def test_pairs_made_beforehand_are_replayed(flow_bench, tmp_path, monkeypatch):
    write_bench(tmp_path, 120, FLOW)
    with pytest.raises(SceneError, match="no prepared pairs"):
        flow_bench(FLOW)
    command = ["prepared", str(tmp_path / "bench.yaml"), "--dt-us", "500", "--pairs", "2"]
    monkeypatch.setattr("sys.argv", command)
    prepare_main()
    world = flow_bench(FLOW).world
    for k in range(4):
        world.lit.flash(0, 100 * k * MS)
        world.lit.flash(1, 100 * k * MS + MS // 2)
    for k, pulse in ((1, 0), (2, 1), (3, 0)):
        start_ns = 100 * k * MS + pulse * MS // 2
        kept = np.load(tmp_path / "ready" / f"pair_{k % 2:05d}_{'ab'[pulse]}.npy")
        np.testing.assert_array_equal(world.expose(0, start_ns, start_ns + 1), kept)


def test_without_a_flow_nothing_of_it_is_there(tmp_path):
    bench = SimulatedBench(load_bench(write_bench(tmp_path, 96)), "chessboard")
    try:
        assert bench.world.lit is None
        assert list(bench.secrets()) == ["truth.yaml"]
        assert bench.world.expose(0, 0, 1).shape == (96, 96)
    finally:
        bench.close()
