"""A camera that is not what it says: another format, settings that vanish, another clock; on both backends."""

import numpy as np
import pytest

from daq.bench.bench_table import CameraSection
from daq.cameras import camera as waiting
from daq.cameras.frame import Frame, FrameMeta
from daq.errors import OtherFormat
from daq.runner.camera_session import CameraSession, FrameFormat
from daq.runner.run_camera import RunCamera
from daq.runner.runner import Runner
from daq.runner.session import Request, begin
from daq.runs.raw_frame import read_raw
from daq.runs.run_folder import frame_entries
from sim.camera.config import CameraConfig, FaultPlan
from tests.daq.cameras.rigs import RIGS
from tests.daq.small_bench import FILES_CAMERA, SHIFT, files_bench, load
from tests.slow_cases import slow, slow_but

SOFTWARE = {"TriggerSelector": "FrameStart", "TriggerMode": "On", "TriggerSource": "Software"}
SMALL = {"width": 64, "height": 16, "row_time_us": 20.0}
TRIPLE_DB = 9.542425  # Gain at which grey values are three times as high


@pytest.fixture(params=list(RIGS))
def rig(request, tmp_path, monkeypatch):
    monkeypatch.setattr(waiting, "PROBE_MIN_S", 10.0)  # a busy machine is no lost camera
    rig = RIGS[request.param](tmp_path)
    yield rig
    rig.close()


def exposures_of(camera, **settings):
    section = CameraSection(backend="any", settings=SOFTWARE | settings, timeout_s=1.0, buffers=8)
    camera.open()
    exposures = CameraSession(camera, section)
    exposures.set_up()
    return exposures


@pytest.mark.parametrize("settings", [slow(SOFTWARE), {"TriggerMode": "Off", "AcquisitionFrameRate": 50.0}])
def test_frames_in_another_format_than_read_back_are_refused_at_the_first(rig, settings):
    exposures = exposures_of(rig.make(CameraConfig(**SMALL, delivers="Mono8")), PixelFormat="Mono12", **settings)
    with pytest.raises(OtherFormat, match=r"sends Mono8 of 64 x 16 px and reads Mono12 of 64 x 16 px back"):
        next(exposures.frames(3))
    exposures.end()
    books = exposures.accounting(0)
    assert books.written == 0
    assert books.rejected >= 1
    assert books.imbalance == 0


@pytest.mark.parametrize(
    ("told", "shape", "said"),
    [
        ({"PixelFormat": "Mono12", "Width": 3, "Height": 2}, (2, 3), ""),
        ({"PixelFormat": "Mono12p", "Width": 3, "Height": 2}, (2, 3), "of 3 x 2 px and reads Mono12p"),
        ({"PixelFormat": "Mono12", "Width": 2, "Height": 3}, (2, 3), "reads Mono12 of 2 x 3 px back"),
        ({"Height": 3}, (2, 3), "reads Mono12 of 3 x 3 px back"),
        ({"PixelFormat": "Mono12PackedByUs"}, (2, 3), ""),
        ({}, (2, 3), ""),
    ],
)
def test_what_a_camera_does_not_tell_is_not_compared(told, shape, said):
    frame = Frame(np.zeros(shape, np.uint16), FrameMeta(1, 0, 1, 1, 100.0, "Mono12", 12))
    found = FrameFormat(told).contradiction(frame)
    assert said in found
    assert bool(found) == bool(said)


@pytest.mark.parametrize("rig", slow_but(RIGS, "aravis", "memory"), indirect=True)  # the contract has the other
def test_an_incomplete_frame_is_not_waited_for(rig):
    """A minute of patience: nothing of it is spent, and the frames are those of the triggers after."""
    camera = rig.make(CameraConfig(**SMALL, faults=FaultPlan(incomplete=(1, 2, 4))))
    camera.open()
    exposures = CameraSession(camera, CameraSection(backend="any", settings=SOFTWARE, timeout_s=60.0, buffers=8))
    exposures.set_up()
    shown = []
    for _, frame in exposures.frames(4):
        shown.append(int(frame.pixels[0, 0]))
        frame.release()
    assert shown == [0, 3, 5, 6]
    assert exposures.counts.timeouts == 0
    books = exposures.conclude(4)
    assert (books.triggered, books.incomplete, books.losses, books.imbalance) == (7, 3, 0, 0)


@pytest.mark.parametrize("rig", slow_but(RIGS, "aravis", "memory"), indirect=True)  # the contract has the other
@pytest.mark.parametrize("fault", ["reset_at", pytest.param("restart_at", marks=pytest.mark.slow)])
def test_no_frame_is_kept_that_was_exposed_after_the_settings_were_lost(rig, tmp_path, fault):
    """The default gain shows in the pixels: a third of what was asked for."""
    bench, plan = load(tmp_path, SHIFT, camera=FILES_CAMERA.replace("0.3", "1.0") + "  retakes: 20\n")
    folder = begin(Request(bench.path, plan.path, correct=False), bench, plan, tmp_path / "runs")
    camera = rig.make(CameraConfig(**SMALL, faults=FaultPlan(**{fault: 4})))
    bench.table.camera.settings.update(Gain=TRIPLE_DB, **SOFTWARE)
    with files_bench(bench, tmp_path, lambda folder: camera) as hardware:
        done = Runner(hardware, [RunCamera(hardware, folder)], plan.steps).run()
    assert done["frames"] == 8
    assert done["conservation"]["imbalance"] == 0
    shown = [int(read_raw(folder.frame_path(n))[0][0, 0]) for n in sorted(frame_entries(folder.entries()))]
    assert all(value % 3 == 0 for value in shown)
    assert shown[:4] == [0, 3, 6, 9]  # each the number of its trigger
    if hasattr(rig, "_devices"):  # with Harvesters a reopened camera begins anew
        assert shown == sorted(set(shown))


@pytest.mark.parametrize("rig", slow_but(RIGS, "aravis", "memory"), indirect=True)  # test_late_frames has it
@pytest.mark.parametrize("kind", [slow({"has_clock": False}), {"stamp_offset_ns": 10**15}])
def test_a_clock_that_is_another_or_cannot_be_read_still_tells_late_frames(rig, kind):
    camera = rig.make(CameraConfig(**SMALL, faults=FaultPlan(late_s={"9": 1.6}), **kind))
    exposures = exposures_of(camera)
    real, sent, filed = camera.trigger, [], []

    def trigger():
        sent.append(stop)
        return real()

    camera.trigger = trigger
    for stop in range(14):
        for _, frame in exposures.frames(1):
            filed.append((stop, int(frame.pixels[0, 0])))
            frame.release()
    accounting = exposures.conclude(len(filed))
    assert not exposures.ambiguities
    assert accounting.imbalance == 0
    assert all(sent[shown] == at for at, shown in filed)
