"""Keep-out stands before everything that moves: the verb `stage`, runs, resumed runs."""

import pytest

from daq.bench.bench_file import load_bench
from daq.bench.guards import idle_stage
from daq.bench.opened import open_bench
from daq.plans.forecast import forecast
from daq.plans.plan import load_plan
from daq.runner.arrival import go_to
from daq.runner.run_camera import RunCamera
from daq.runner.runner import Runner
from daq.runner.session import Request, begin
from stages.errors import Obstructed
from tests.daq.small_bench import FILES_CAMERA, TARGET, files_bench, load, write_frames


@pytest.fixture
def bench_and_plan(tmp_path):
    write_frames(tmp_path / "frames_in", 8)
    return load(tmp_path, TARGET, camera=FILES_CAMERA)


def at_scene(hardware):
    """Bring every axis to the place of the scene file, along the safe route: glass and target touch there."""
    hardware.stage.home()
    go_to(hardware, hardware.bench.home_mm, {})


@pytest.mark.parametrize("only", [(), ("stages",)])
def test_whoever_opens_a_bench_gets_a_guard(bench_and_plan, mocker, only):
    mocker.patch("daq.bench.kinds.make_camera")
    with open_bench(bench_and_plan[0], True, only=only) as found:
        assert found.stage.guard is not None


def test_contact_is_legal_and_nothing_beyond_it(bench_and_plan, tmp_path):
    with files_bench(bench_and_plan[0], tmp_path / "frames_in", home=False) as hardware:
        at_scene(hardware)
        before_mm = hardware.simulation.true_mm()
        with pytest.raises(Obstructed, match=r"target_z .* would bring .* near"):
            hardware.stage.move({"target_z": hardware.stage.axis("target_z").position_mm + 1.0})  # a jog
        with pytest.raises(Obstructed, match=r"glass_z .* near .* the target"):
            hardware.stage.move({"glass_z": -0.5})
        assert hardware.simulation.true_mm() == before_mm
        hardware.stage.move({"target_z": -1.0})  # away from the glass, and back into contact
        hardware.stage.move({"target_z": 0.0})


def test_a_resumed_run_is_judged_from_where_the_axes_are(bench_and_plan, tmp_path):
    """Somebody has brought the camera close meanwhile: the glass must not retract into it."""
    path = bench_and_plan[0].path
    text = path.read_text()
    path.write_text(
        text.replace("clearance_mm: 2.0", "clearance_mm: 45.0").replace("ahead_mm: 60.0", "ahead_mm: 100.0")
    )
    bench = load_bench(path)
    plan = load_plan(bench_and_plan[1].path, bench)
    folder = begin(Request(bench.path, plan.path, correct=False), bench, plan, tmp_path / "runs")
    assert not forecast(bench, idle_stage(bench), plan.steps).violations
    with files_bench(bench, tmp_path / "frames_in", home=False) as hardware:
        at_scene(hardware)
        hardware.stage.move({"rail_z": -194.0})
        with pytest.raises(Obstructed, match=r"glass_z from .* to 30\.5 mm would bring far .* the camera"):
            Runner(hardware, [RunCamera(hardware, folder)], plan.steps).run()
        assert folder.entries()[-1]["why"] == "Obstructed"
        hardware.stage.move({"rail_z": 0.0})
        Runner(hardware, [RunCamera(hardware, folder)], plan.steps).run()
    assert folder.is_done
