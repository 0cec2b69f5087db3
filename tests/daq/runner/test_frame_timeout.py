"""A timeout that no frame can meet is refused by name before the run; a camera that tells nothing is believed."""

import pytest

from daq.errors import RunUsageError
from daq.runner.camera_session import check_frame_timeout
from daq.runner.run_camera import RunCamera
from daq.runner.runner import Runner
from daq.runner.session import Request, begin
from tests.daq.small_bench import FILES_CAMERA, SHIFT, files_bench, load, write_frames
from tests.loops import loop_over

TRIGGERED = {"TriggerMode": "On", "TriggerSource": "Software"}
UNLIMITED = {"DeviceLinkThroughputLimit": 1e6, "DeviceLinkThroughputLimitMode": "Off"}
SLOW = {"ExposureTime": 250_000.0, "SensorReadoutTime": 30_000.0, "PayloadSize": 6_000_000}


@loop_over("settings, needed_s",
    [
        ({"ExposureTime": 250_000.0}, 0.25),
        ({"ExposureTimeAbs": 250_000.0}, 0.25),
        (SLOW, 0.28),
        (SLOW | {"DeviceLinkThroughputLimit": 60_000_000}, 0.38),
        (SLOW | UNLIMITED, 0.28),
        (SLOW | UNLIMITED | {"DeviceLinkSpeed": 6e7}, 0.38),
        (SLOW | {"GevLinkSpeed": 1000}, 0.328),
        (SLOW | {"DeviceLinkSpeed": 1000}, 0.28),  # megabits, no doubt
        (SLOW | {"ResultingFrameRate": 2.0}, 0.5),
        (SLOW | {"AcquisitionResultingFrameRate": 100.0}, 0.28),
        (SLOW | {"AcquisitionFrameRate": 0.1}, 0.28),  # does not matter: we decide when
    ],
)  # fmt: skip
def test_what_a_triggered_frame_takes(settings, needed_s):
    with pytest.raises(RunUsageError, match=f"timeout_s = 0.24 .* more than {needed_s:g}$"):
        check_frame_timeout(0.24, TRIGGERED | settings)
    check_frame_timeout(needed_s + 1e-3, TRIGGERED | settings)


@pytest.mark.parametrize(
    ("settings", "needed_s"),
    [
        ({"AcquisitionFrameRate": 2.0}, 0.5),
        ({"AcquisitionFrameRate": 2.0, "AcquisitionFrameRateEnable": True, "ExposureTime": 4e5}, 0.9),
        ({"AcquisitionFrameRate": 2.0, "AcquisitionFrameRateEnable": False, "ExposureTime": 4e5}, 0.4),
    ],
)
def test_what_a_camera_takes_that_runs_by_itself(settings, needed_s):
    with pytest.raises(RunUsageError, match=f"more than {needed_s:g}$"):
        check_frame_timeout(0.24, {"TriggerMode": "Off"} | settings)
    check_frame_timeout(needed_s + 1e-3, {"TriggerMode": "Off"} | settings)


def test_an_outer_trigger_may_come_at_any_time():
    check_frame_timeout(0.1, {"TriggerMode": "On", "TriggerSource": "Line1", "AcquisitionFrameRate": 0.01})


@pytest.mark.parametrize(
    "settings",
    [{}, {"ExposureTime": float("nan")}, {"ExposureTime": "long"}, {"ExposureTime": 0.0}, {"PayloadSize": 10**9},
     {"DeviceLinkSpeed": 10}, {"ResultingFrameRate": 0.0}, {"Width": 10**6}],
)  # fmt: skip
def test_who_tells_nothing_is_not_refused(settings):
    check_frame_timeout(1e-6, TRIGGERED | settings)


def test_a_run_is_refused_before_anything_moves(tmp_path):
    camera = FILES_CAMERA.replace("TriggerSource: Software", "TriggerSource: Software, ExposureTime: 400000.0")
    bench, plan = load(tmp_path, SHIFT, camera=camera)
    folder = begin(Request(bench.path, plan.path, correct=False), bench, plan, tmp_path / "runs")
    with files_bench(bench, write_frames(tmp_path / "frames_in", 8)) as hardware:
        here_mm = hardware.simulation.true_mm()
        with pytest.raises(RunUsageError, match=r"timeout_s = 0.3 .*exposure 0.4 s.* more than 0.4"):
            Runner(hardware, [RunCamera(hardware, folder)], plan.steps).run()
        assert hardware.simulation.true_mm() == here_mm
    assert not list((folder.path / "frames").iterdir())
