"""What a camera tells between steps reaches the journal; what it does not tell, or does wrong, ends nothing."""

import time
from dataclasses import replace

import pytest

from daq.bench.bench_table import CameraSection
from daq.cameras.files import FilesCamera
from daq.cameras.frame import Frame
from daq.errors import CameraLost
from daq.runner.camera_session import CameraSession
from daq.runner.run_camera import RunCamera
from daq.runner.runner import Runner
from daq.runner.session import Request, begin
from daq.runner.step_readings import camera_facts
from daq.runs.clock_map import clock_maps
from daq.runs.run_check import check_run
from daq.runs.run_folder import frame_entries
from tests.daq.small_bench import FILES_CAMERA, SHIFT, files_bench, load, write_frames

PPM = 40.0


class TellingCamera(FilesCamera):
    """A camera that is warm, has a fast clock and sends chunk data."""

    def read(self, names):
        return {"DeviceTemperature": 38.25} if "DeviceTemperature" in names else {}

    def clock_ns(self):
        return round(super().clock_ns() * (1.0 + PPM * 1e-6))

    def configure(self, settings, chunks=()):
        self.asked = tuple(chunks)
        return super().configure(settings)

    def _show(self, due_ns):
        frame = super()._show(due_ns)
        chunks = {"Timestamp": 9_007_199_254_740_993, "ExposureTime": 20.5, "Gain": 3.0}
        return Frame(frame.pixels, replace(frame.meta, chunks=chunks))


def run(tmp_path, camera, camera_class):
    bench, plan = load(tmp_path, SHIFT, camera=camera)
    folder = begin(Request(bench.path, plan.path, correct=False), bench, plan, tmp_path / "runs")
    with files_bench(bench, write_frames(tmp_path / "frames_in", 8), camera_class) as hardware:
        Runner(hardware, [RunCamera(hardware, folder)], plan.steps).run()
        assert getattr(hardware.camera, "asked", None) in (None, tuple(bench.table.camera.chunks))
    return folder


def test_temperature_clock_and_chunks_are_on_the_record(tmp_path):
    camera = FILES_CAMERA + "  chunks: [Timestamp, ExposureTime]\n"
    folder = run(tmp_path, camera, TellingCamera)
    entries = folder.entries()
    lines = [entry for entry in entries if entry["kind"] == "camera"]
    assert len(lines) == 9  # before the first step and behind each of eight
    assert {line["celsius"] for line in lines} == {38.25}
    (found,) = clock_maps(entries)
    assert found.drift_ppm == pytest.approx(-PPM, abs=4.0 * found.drift_sigma_ppm)
    frames = frame_entries(entries).values()
    assert [entry["chunks"] for entry in frames] == [
        {"Timestamp": 9_007_199_254_740_993, "ExposureTime": 20.5}
    ] * 8
    said = {finding.part: finding for finding in check_run(folder.path).findings}
    assert "38.2 to 38.2 C" in said["camera"].said
    assert all(finding.sound for finding in said.values())


def test_who_asks_for_no_chunks_finds_none_in_the_record(tmp_path):
    camera = TellingCamera(write_frames(tmp_path / "in", 1))
    camera.open()
    camera.configure({"TriggerMode": "On"})
    camera.arm()
    camera.trigger()
    frame = camera.next_frame(1.0)
    kept = {
        wanted: CameraSection(backend="files", chunks=list(wanted)) for wanted in ((), ("Gain", "NoSuchThing"))
    }
    found = [CameraSession(camera, section).facts(frame) for section in kept.values()]
    assert found == [{}, {"chunks": {"Gain": 3.0}}]


class Gone(FilesCamera):
    def clock_ns(self):
        raise CameraLost("gone")


class Mute(FilesCamera):
    def clock_ns(self):
        return None

    def read(self, names):
        return {"DeviceTemperature": float("nan")}


@pytest.mark.parametrize("kind", [Gone, Mute])
def test_what_a_camera_does_not_tell_is_left_out(tmp_path, kind):
    write_frames(tmp_path / "in", 1)
    camera = kind(tmp_path / "in")
    camera.open()
    assert camera_facts(camera) == {}


class Unplugged(FilesCamera):
    """Loses its cable in its first exposure: it says nothing, and answers nothing."""

    def poll(self, timeout_s):
        time.sleep(timeout_s)

    def probe(self, timeout_s):
        raise CameraLost("no answer")


def test_a_pulled_cable_is_known_long_before_the_timeout(tmp_path):
    """Ten minutes for a frame, of a long exposure or a trigger from outside."""
    write_frames(tmp_path / "in", 1)
    section = CameraSection(backend="files", settings={"TriggerMode": "On"}, timeout_s=600.0)
    session = CameraSession(Unplugged(tmp_path / "in"), section)
    begun_s = time.monotonic()
    with pytest.raises(CameraLost):
        session.wait_until(session.now_s() + section.timeout_s)
    with pytest.raises(CameraLost):
        [session.look(0.05) for _ in range(200)]  # as pairs are waited for
    assert time.monotonic() - begun_s < 10.0
