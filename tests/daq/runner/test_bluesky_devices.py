"""A Bluesky RunEngine scans the bench: what must not be is refused, and what it asks at once goes in turns."""

import threading

import pytest

from daq.runner.devices import axis_devices
from stages.errors import MotionBarred, MotionStopped, Obstructed, OutOfRange
from tests.fuzz.benches.bench import fuzz_bench

pytest.importorskip("bluesky")


@pytest.fixture
def bench():
    with fuzz_bench() as made:
        yield made


@pytest.fixture
def scanned(bench):
    """Run a plan; the events, and how the run ended."""
    from bluesky import RunEngine

    engine = RunEngine({}, context_managers=[])
    documents = []

    def run(plan):
        documents.clear()
        try:
            engine(plan, lambda name, document: documents.append((name, document)))
        finally:
            run.exit_status = documents[-1][1].get("exit_status") if documents else None
        return [document["data"] for name, document in documents if name == "event"]

    return run


def true_mm(bench):
    return {name: bench.world.true_mm(name) for name in bench.stage.axes}


def refused(run, plan):
    """Why a status has failed the plan."""
    from bluesky.utils import FailedStatus

    with pytest.raises(FailedStatus) as failed:
        run(plan)
    assert run.exit_status in (None, "fail")  # None: the plan had opened no run
    assert str(failed.value.__cause__) in str(failed.value)  # the sentence, for who reads the engine's words
    return failed.value.__cause__


def test_scans_of_one_axis_and_of_a_grid(bench, scanned):
    from bluesky import plans as bp

    axes = axis_devices(bench.stage)
    events = scanned(bp.scan([axes["rail_z"]], axes["target_z"], 0.0, 20.0, 3))
    assert [event["target_z"] for event in events] == pytest.approx([0.0, 10.0, 20.0], abs=0.01)
    assert scanned.exit_status == "success"
    events = scanned(bp.grid_scan([], axes["camera_x"], -5.0, 5.0, 2, axes["camera_y"], -5.0, 5.0, 2))
    assert len(events) == 4
    events = scanned(bp.rel_scan([], axes["target_z"], -1.0, 1.0, 2))
    assert [event["target_z"] for event in events] == pytest.approx([19.0, 21.0], abs=0.02)
    assert bench.world.true_mm("target_z") == pytest.approx(20.0, abs=0.1)  # and back


def test_a_scan_out_of_limits_ends_before_it(bench, scanned):
    from bluesky import plans as bp

    axes = axis_devices(bench.stage)
    why = refused(scanned, bp.scan([], axes["target_z"], 0.0, 100.0, 3))
    assert isinstance(why, OutOfRange)
    assert bench.world.true_mm("target_z") == pytest.approx(0.0, abs=0.1)
    assert not bench.stage.is_held


def test_a_scan_through_the_target_is_refused_whatever_the_engine_thinks(bench, scanned):
    from bluesky import plans as bp

    axes = axis_devices(bench.stage)
    stood = true_mm(bench)
    assert isinstance(refused(scanned, bp.scan([], axes["glass_x"], 0.0, 10.0, 3)), Obstructed)
    assert true_mm(bench) == stood


def test_axes_set_at_once_move_in_turns_each_judged_from_where_the_last_has_come_to(bench, scanned):
    """Glass and target, each free to go alone; together they would meet."""
    from bluesky import plan_stubs as bps

    axes = axis_devices(bench.stage)
    for name, mm in (("glass_z", 20.0), ("glass_x", 0.0), ("glass_z", 0.0), ("target_z", 0.0)):
        scanned(bps.mv(axes[name], mm))
    asked = {"glass_z": -8.0, "target_z": 10.0}
    for name, mm in asked.items():
        bench.stage.check(bench.stage.where_mm(), {name: mm})
    why = refused(scanned, bps.mv(*(part for name, mm in asked.items() for part in (axes[name], mm))))
    assert isinstance(why, Obstructed | MotionStopped)  # what truly came together, the witness judges
    assert sum(abs(true_mm(bench)[name] - mm) < 0.1 for name, mm in asked.items()) <= 1


def test_a_stop_by_a_person_ends_the_scan_and_holds(bench, scanned):
    from bluesky import plans as bp

    axes = axis_devices(bench.stage)
    bench.clock.after(0.4, bench.stage.stop)
    assert isinstance(refused(scanned, bp.scan([], axes["target_z"], 0.0, 20.0, 5)), MotionStopped)
    assert bench.stage.is_held
    assert isinstance(refused(scanned, bp.scan([], axes["target_z"], 0.0, 20.0, 5)), MotionStopped)
    bench.stage.clear_stop()
    assert len(scanned(bp.scan([], axes["target_z"], 0.0, 20.0, 5))) == 5


def test_what_bars_motion_bars_the_engine(bench, scanned):
    from bluesky import plans as bp

    axes = axis_devices(bench.stage)
    bench.stage.bar_motion(lambda: "the laser is armed")
    stood = true_mm(bench)
    assert isinstance(refused(scanned, bp.scan([], axes["target_z"], 5.0, 20.0, 5)), MotionBarred)
    assert true_mm(bench) == stood


def test_a_status_says_how_it_goes(bench):
    axis = axis_devices(bench.stage)["target_z"]
    done = threading.Event()
    status = axis.set(5.0)
    status.add_callback(lambda status: done.set())
    assert done.wait(10.0)
    assert repr(status) == "done"
    assert axis.position == pytest.approx(5.0, abs=0.01)
    assert axis.hints == {"fields": ["target_z"]}
