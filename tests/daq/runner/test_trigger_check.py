"""A trigger is tried out: what arrives, what does not, and exposures that are not what was set."""

import threading
import time
from dataclasses import replace

import pytest

from daq.bench.bench_file import load_bench
from daq.bench.bench_table import PRESETS, CameraSection, needs_line
from daq.cameras.files import FilesCamera
from daq.cameras.frame import Frame
from daq.runner.trigger_check import try_trigger
from ground.errors import ConfigError
from rtpiv.command_line.cli import DEVICE, DONE, main
from sim.camera.config import CameraConfig
from sim.camera.wires import Wires
from tests.daq.cameras.rigs import RIGS
from tests.daq.small_bench import write_bench, write_frames
from tests.slow_cases import slow_but


class Exposed(FilesCamera):
    """Files that say how long they were exposed."""

    factor, sends, gives = 1.0, True, 99

    def configure(self, settings, chunks=()):
        return super().configure(settings, () if self.sends else chunks)

    def _show(self, due_ns):
        frame = super()._show(due_ns)
        chunks = {"ExposureTime": self.factor * frame.meta.exposure_us} if self.sends else {}
        return Frame(frame.pixels, replace(frame.meta, chunks=chunks))

    def poll(self, timeout_s):
        return super().poll(timeout_s) if self._next_file < self.gives else time.sleep(timeout_s)


def tried(folder, kind, **more):
    camera = kind(write_frames(folder, 8))
    camera.open()
    section = CameraSection(
        backend="files", settings={"ExposureTime": 500.0}, trigger={"preset": "software"}, timeout_s=0.2, **more
    )
    return {found.what: (found.is_right, found.said) for found in try_trigger(camera, section)}


def test_a_trigger_that_works(tmp_path):
    found = tried(tmp_path, Exposed)
    assert [right for right, _ in found.values()] == [True, True, True]
    assert found["trigger"][1].startswith("6 of 6 frames by Software")
    assert found["exposure"][1] == "500 us, set to 500 us"


@pytest.mark.parametrize(("changes", "what", "right", "words"), [
    ({"factor": 1.1}, "exposure", False, "550 us, set to 500 us"),
    ({"factor": 0.99}, "exposure", True, "495 us"),
    ({"sends": False}, "exposure", None, "only what reads back is known"),
    ({"gives": 2}, "trigger", False, "2 of 6 frames by Software: no frame within 0.2 s"),
])  # fmt: skip
def test_what_is_wrong_is_said(tmp_path, changes, what, right, words):
    found = tried(tmp_path, type("Changed", (Exposed,), changes))
    assert found[what][0] is right
    assert words in found[what][1]


@pytest.mark.parametrize("rig", slow_but(RIGS, "aravis", "memory"))  # flows are triggered on lines of the other
def test_pulses_on_a_line_arrive_or_not(tmp_path, rig):
    made, wires = RIGS[rig](tmp_path), Wires(tmp_path)
    end = threading.Event()

    def pulses():
        while not end.wait(0.05):
            now_ns = time.monotonic_ns()
            wires.pulse(1, now_ns, now_ns + 1_000_000)

    unit = threading.Thread(target=pulses)
    unit.start()
    try:
        camera = made.make(CameraConfig(width=32, height=8, wires=str(wires.path)))
        camera.open()
        line = {"preset": "edge", "line": "Line1"}
        section = CameraSection(backend="x", settings={"ExposureTime": 300.0}, trigger=line, timeout_s=2.0)
        settings, trigger, exposure = try_trigger(camera, section)
        assert (settings.is_right, trigger.is_right, exposure.is_right) == (True, True, True), trigger
        assert "6 of 6 frames by Line1, " in trigger.said
        assert exposure.said == "300 us, set to 300 us"
        end.set()
        unit.join()
        _, silent = try_trigger(camera, section.model_copy(update={"timeout_s": 0.3}))
        assert (silent.is_right, silent.said[:24]) == (False, "0 of 6 frames by Line1: ")
    finally:
        end.set()
        made.close()
        wires.close()


def test_every_preset_is_taken_with_its_line_alone():
    for name in PRESETS:
        line = {"line": "Line3"} if needs_line(name) else {}
        section = CameraSection(backend="files", trigger={"preset": name, **line})
        assert ("Line3" in section.settings.values()) == needs_line(name)
        with pytest.raises(ValueError, match="line"):
            CameraSection(backend="files", trigger={"preset": name, **({} if line else {"line": "Line3"})})


CAMERA = """camera:
  backend: files
  options: {{folder: in}}
  settings: {{ExposureTime: 400.0{settings}}}
  trigger: {{preset: software}}
"""


def test_settings_that_contradict_a_preset_are_refused(tmp_path):
    assert load_bench(write_bench(tmp_path, camera=CAMERA.format(settings=""))).table.camera.settings == {
        "ExposureTime": 400.0, "TriggerSelector": "FrameStart", "TriggerSource": "Software", "TriggerMode": "On"
    }  # fmt: skip
    with pytest.raises(ConfigError, match=r"bench.yaml:\d+: .*disagree about TriggerSource"):
        load_bench(write_bench(tmp_path, camera=CAMERA.format(settings=", TriggerSource: Line1")))


def test_the_verb_says_it(tmp_path, capsys, monkeypatch):
    bench = write_bench(tmp_path, camera=CAMERA.format(settings=""))
    monkeypatch.chdir(tmp_path)
    write_frames(tmp_path / "in", 8)
    assert main(["bench", "camera", "test", "--bench", str(bench)]) == DONE
    assert "trigger    ok   6 of 6 frames by Software" in capsys.readouterr().out
    write_frames(tmp_path / "few", 3)
    bench.write_text(bench.read_text().replace("folder: in", "folder: few") + "\n")
    bench.write_text(bench.read_text().replace("  trigger:", "  timeout_s: 0.2\n  trigger:"))
    assert main(["bench", "camera", "test", "--bench", str(bench)]) == DEVICE
    said = capsys.readouterr()
    assert "trigger    BAD" in said.out
    assert "the camera's trigger is not as the bench file sets it up" in " ".join(said.err.split())
