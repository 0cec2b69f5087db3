"""A frame that comes after its timeout must never be filed under a later stop: both backends, real transports.

The simulated camera prints the number of the trigger into pixel (0, 0), so every frame says which one it shows.
"""

import pytest

from daq.bench.bench_table import CameraSection
from daq.cameras import camera as waiting
from daq.runner.camera_session import CameraSession
from sim.camera.config import CameraConfig, FaultPlan
from tests.daq.cameras.rigs import RIGS
from tests.slow_cases import slow

SOFTWARE = {"TriggerSelector": "FrameStart", "TriggerMode": "On", "TriggerSource": "Software"}
SECTION = CameraSection(backend="any", settings=SOFTWARE, timeout_s=0.3, buffers=8, retakes=20)
SMALL = {"width": 64, "height": 16, "row_time_us": 20.0}


@pytest.fixture
def rig(request, tmp_path, monkeypatch):
    monkeypatch.setattr(waiting, "PROBE_MIN_S", 10.0)  # a busy machine is no lost camera
    rig = RIGS[request.param](tmp_path)
    yield rig
    rig.close()


def counted(camera):
    """The same camera, with the number of triggers that were sent."""
    real, camera.sent = camera.trigger, 0

    def trigger():
        camera.sent += 1
        return real()

    camera.trigger = trigger
    return camera


def take(exposures, camera, stops):
    """One frame at each of some stops; the trigger that each shows, and whether it was sent at that stop."""
    seen = []
    for _ in range(stops):
        before = camera.sent
        for _, frame in exposures.frames(1):
            seen.append((int(frame.pixels[0, 0]), before, camera.sent))
            frame.release()
    return seen


# A whole run through each backend with the second and the fifth frame late: test_doubt.py.
CASES = [(rig, {"0": 0.8}) for rig in RIGS] + [("memory", {"1": 0.8, "4": 0.8})]
CASES += [slow(rig, {"1": 0.8, "4": 0.8}) for rig in RIGS if rig != "memory"]
CASES += [slow(rig, {"2": 0.8}) for rig in RIGS]


@pytest.mark.parametrize(("rig", "late_s"), CASES, indirect=["rig"])
def test_no_frame_is_filed_under_a_stop_that_it_does_not_show(rig, late_s):
    camera = counted(rig.make(CameraConfig(**SMALL, faults=FaultPlan(late_s=late_s))))
    camera.open()
    exposures = CameraSession(camera, SECTION)
    exposures.set_up()
    seen = take(exposures, camera, 7)
    exposures.end()
    wrong = [(shown, before, after) for shown, before, after in seen if not before <= shown < after]
    assert not wrong
    books = exposures.accounting(len(seen))
    assert books.imbalance == 0, books.sentence()
    assert min(books.to_dict().values()) >= 0
    assert books.rejected + books.silent >= len(late_s)  # it came too late, or not at all
    assert books.triggered == camera.sent
