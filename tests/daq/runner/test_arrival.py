"""A step counts only if its axes were where it says, before its first frame and after its last one."""

from types import SimpleNamespace

import pytest

from daq.cameras.files import FilesCamera
from daq.errors import PlanError
from daq.runner.arrival import go_to, off_by_mm
from daq.runner.run_camera import RunCamera
from daq.runner.runner import Runner
from daq.runner.session import Request, begin
from daq.runs.run_folder import frame_entries, steps_on_disk
from stages.errors import MotionStopped, NotInPosition
from tests.daq.small_bench import FILES_CAMERA, SHIFT, files_bench, load, write_frames
from tests.slow_cases import slow

PLAN = SHIFT + "frames: 2\n"


@pytest.fixture
def run(tmp_path):
    bench, plan = load(tmp_path, PLAN, camera=FILES_CAMERA)
    folder = begin(Request(bench.path, plan.path, correct=False), bench, plan, tmp_path / "runs")
    return bench, plan, folder, write_frames(tmp_path / "frames_in", 40)


class Disturbed(FilesCamera):
    """A camera that lets something happen before or after a frame of a certain number is taken."""

    at, count, act = 5, 0, None

    def poll(self, timeout_s):
        frame = super().poll(timeout_s)
        if frame is None:
            return None
        type(self).count += 1
        if self.count == self.at and type(self).act is not None:
            type(self).act()
        return frame


@pytest.fixture
def disturbed():
    Disturbed.count, Disturbed.act = 0, None
    return Disturbed


def test_an_axis_that_slips_while_frames_are_taken_fails_its_step(run, disturbed):
    bench, plan, folder, files = run
    with files_bench(bench, files, disturbed) as hardware:
        disturbed.act = lambda: slip_reading(hardware)
        with pytest.raises(NotInPosition, match=r"target_x is \+6.0\d\d mm off its plan.*resume"):
            Runner(hardware, [RunCamera(hardware, folder)], plan.steps).run()
    entries = folder.entries()
    assert steps_on_disk(entries) == {0, 1}
    assert sorted(frame_entries(entries)) == [0, 1, 2, 3]
    (miss,) = [entry for entry in entries if entry["kind"] == "miss"]
    assert miss["step"] == 2
    assert miss["measured_mm"]["target_x"] - miss["planned_mm"]["target_x"] == pytest.approx(6.0, abs=0.01)
    with files_bench(bench, files) as hardware:  # somebody has homed it
        done = Runner(hardware, [RunCamera(hardware, folder)], plan.steps).run()
    assert done["frames"] == 16


def slip_reading(hardware, axis="target_x", mm=6.0):
    """The encoder reads something else than where the axis was sent."""
    part = hardware.stage.axis(axis)
    read = part.controller.position_mm
    part.controller.position_mm = lambda channel: read(channel) + (mm if channel == part.settings.channel else 0.0)


@pytest.mark.parametrize("controller", [slow("rail"), "portal", slow("glass"), "target"])
def test_a_controller_that_restarts_while_frames_are_taken_fails_its_step(run, disturbed, controller):
    bench, plan, folder, files = run
    with files_bench(bench, files, disturbed) as hardware:

        def restart():
            hardware.simulation.lines[controller].power_cycle(0.2)
            hardware.clock.sleep_s(2.0)

        disturbed.act = restart
        with pytest.raises(PlanError, match="have no position reference"):
            Runner(hardware, [RunCamera(hardware, folder)], plan.steps).run()
    assert steps_on_disk(folder.entries()) == {0, 1}
    assert sorted(frame_entries(folder.entries())) == [0, 1, 2, 3]


def test_what_was_believed_does_not_hide_what_is_read(run):
    """A carriage that was moved between two steps is driven back, not taken for where it was sent."""
    bench, _, _, files = run
    with files_bench(bench, files) as hardware:
        go_to(hardware, bench.home_mm, {})
        here_mm = hardware.stage.where_mm()
        hardware.stage.move({"target_x": 6.0})
        true_mm = hardware.simulation.true_mm()["target_x"]
        go_to(hardware, bench.home_mm, bench.home_mm)
        assert hardware.simulation.true_mm()["target_x"] == pytest.approx(true_mm - 6.0, abs=0.01)
        assert hardware.stage.where_mm() == pytest.approx(here_mm, abs=0.01)


def test_a_micrometre_is_no_reason_to_move_again(run, mocker):
    bench, _, _, files = run
    with files_bench(bench, files) as hardware:
        go_to(hardware, bench.home_mm, {})
        move = mocker.spy(hardware.stage, "move")
        go_to(hardware, bench.home_mm, bench.home_mm)
        assert move.call_count == 0


def test_no_frame_is_taken_after_a_stop(run, disturbed):
    bench, plan, folder, files = run
    with files_bench(bench, files, disturbed) as hardware:
        disturbed.act = hardware.stage.stop
        with pytest.raises(MotionStopped):
            Runner(hardware, [RunCamera(hardware, folder)], plan.steps).run()
        assert disturbed.count == disturbed.at
        with pytest.raises(MotionStopped, match="clear"):
            Runner(hardware, [RunCamera(hardware, folder)], plan.steps).run()
        assert disturbed.count == disturbed.at
        hardware.stage.clear_stop()
        assert Runner(hardware, [RunCamera(hardware, folder)], plan.steps).run()["frames"] == 16


@pytest.mark.parametrize(("off_mm", "is_off"), [(0.0045, False), (0.0055, True), (-0.0055, True), (0.5, True)])
def test_a_tolerance_in_micrometres_is_held_against_millimetres(off_mm, is_off):
    axes = {
        name: SimpleNamespace(settings=SimpleNamespace(in_position_um=5.0)) for name in ("glass_x", "target_z")
    }
    hardware = SimpleNamespace(stage=SimpleNamespace(axes=axes))
    planned = {"glass_x": 1.0, "target_z": -3.0}
    found = off_by_mm(hardware, planned, planned | {"target_z": -3.0 + off_mm})
    assert found == ({"target_z": pytest.approx(off_mm)} if is_off else {})
