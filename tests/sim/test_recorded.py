"""What is said on ports is recorded, without waiting for a disk; a rehearsal takes as long as was expected."""

import errno
import io
import os
import re
import shutil
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from daq.bench.bench_file import load_bench
from daq.plans.forecast import frames_s, simulation_s
from daq.plans.plan import load_plan
from ground.rows import thread_count
from sim.bench import SimulatedBench
from sim.expected import STEP_S
from sim.rehearsed import Rehearsed
from stages import dialogue
from stages.dialogue import VARIABLE
from stages.errors import PortUnavailable
from tests.daq.flow_bench import write_flow
from tests.daq.small_bench import EXAMPLES, write_bench

FLOW = (
    'devices:\n  flow: {kind: reading, unit: l/min, port: /dev/ttyFLOW, ask: "RATE?\\n", find: "rate ([0-9.]+)"}\n'
)


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    """A bench on which an axis may be moved before the others are homed."""
    file = write_bench(tmp_path_factory.mktemp("bench"), side_px=96)
    tree = yaml.safe_load(file.read_text())
    del tree["keep_out"]
    file.write_text(yaml.safe_dump(tree, sort_keys=False))
    return file


def test_a_recording_holds_what_was_sent_and_when_answers_came(path, tmp_path, monkeypatch):
    monkeypatch.setenv(VARIABLE, str(tmp_path))
    with Rehearsed(path, seed=3) as bench:
        bench.home("target_x")
        bench.move(target_x=2.0)
    files = sorted(tmp_path.iterdir())
    assert len(files) == len(load_bench(path).table.stages.controllers)
    (file,) = [file for file in files if file.name.startswith("sim-target")]
    lines = file.read_text().splitlines()
    assert lines[0].startswith("# sim://target")
    assert re.fullmatch(r"@ \d+", lines[1])
    sent = b"".join(bytes.fromhex(line[2:]) for line in lines if line.startswith("> "))
    assert sent.decode("latin-1") == bench.event_log().bytes_to("target")
    came = [re.fullmatch(r"<(?: [0-9a-f]{2})+ \+(\d+\.\d{6})", line) for line in lines if line.startswith("<")]
    assert len(came) > 20
    assert 0.0 < max(float(each[1]) for each in came) < 5.0


def test_a_fault_of_a_reading_strikes_the_reading(path, tmp_path):
    folder = tmp_path / "bench"
    shutil.copytree(path.parent, folder)
    with (folder / "bench.yaml").open("a") as file:
        file.write(FLOW)
    with Rehearsed(folder / "bench.yaml", [{"what": "unplug", "of": "flow", "at_s": 0.1}]) as bench:
        bench.home("target_x")
        assert bench.event_log().faults == ["unplug of flow at 0.1 s"]
        assert bench.device("flow").reading().missing


def test_a_folder_that_cannot_be_written_is_one_sentence(path, tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv(VARIABLE, str(tmp_path / "file"))
    with pytest.raises(PortUnavailable, match=r"RTPIV_RECORD names .* nothing can be written"), Rehearsed(path):
        pass


def test_a_port_never_waits_for_the_disk_of_a_recording(tmp_path, monkeypatch):
    """The stop of an axis goes by this port: with a disk that hangs it leaves as if nobody recorded."""
    hangs = threading.Event()

    class Hung(io.StringIO):
        def write(self, text):
            hangs.wait(60.0)
            raise OSError(errno.EIO, "I/O error")

    monkeypatch.setattr(Path, "open", lambda place, *words, **more: Hung())
    monkeypatch.setattr(dialogue, "DISK_PATIENCE_S", 0.05)
    monkeypatch.setattr(dialogue, "MOST_WAITING", 10)
    recording = dialogue.RecordedFile(tmp_path / "hung.txt")
    began_s = time.monotonic()
    for number in range(1000):
        recording.line(f"> {number:02x}")
    recording.close()
    assert time.monotonic() - began_s < 5.0  # a disk that is asked takes 60 s
    hangs.set()


def test_recordings_of_one_port_that_begin_at_once_are_files_of_their_own(tmp_path, monkeypatch):
    monkeypatch.setenv(VARIABLE, str(tmp_path))
    with ThreadPoolExecutor(8) as pool:
        files = list(pool.map(dialogue.recording_file, ["/dev/ttyUSB0"] * 40))
    for number, file in enumerate(files):
        file.line(f"> {number:02x}")
        file.close()
    said = {path.read_text().splitlines()[-1] for path in tmp_path.iterdir()}
    assert said == {f"> {number:02x}" for number in range(40)}


# The expected time of a rehearsal beside the processor time that its pictures take, on several benches.


TARGET = "experiment: target\nclear: {z_mm: [-10.0]}\nglass: {z_mm: [0.0]}\n"
LENS = "\naperture: {f_mm: 60.0, f_number: 2.8, focus_mm: 500.0}"


@pytest.mark.slow
@pytest.mark.parametrize(("scene", "simulation"), [
    ("", "samples: 4"), ("", "samples: 3" + LENS), ("three_spheres_500.yaml", "samples: 4"),
    ("furnace_window.yaml", "samples: 2"),
])  # fmt: skip
def test_pictures_take_what_was_expected(tmp_path, scene, simulation):
    """By processor time: what else the computer does is not meant."""
    side_px = 360
    path = write_bench(tmp_path, side_px, f"{simulation}\ncamera_transport: memory")
    if scene:
        text = (EXAMPLES / scene).read_text()
        text = re.sub(r"sensor_px: .*\]", f"sensor_px: [{side_px}, {side_px}]", text)
        (tmp_path / "scene.yaml").write_text(text)
    (tmp_path / "plan.yaml").write_text(TARGET)
    bench = load_bench(path)
    (step,) = [step for step in load_plan(tmp_path / "plan.yaml", bench).steps if step.view == "glass"]
    simulation_s(bench, [step])  # code is loaded once
    estimate_s = thread_count() * (sum(simulation_s(bench, [replace(step, frames=0)])) - STEP_S)
    simulation = SimulatedBench(bench)
    try:
        simulation.place(step.targets_mm)
        begun_s = sum(os.times()[:2])
        simulation.world.light()
        took_s = sum(os.times()[:2]) - begun_s
    finally:
        simulation.close()
    assert took_s / 1.5 < estimate_s < 1.5 * took_s + 0.02  # ticks of 10 ms


def test_a_flow_is_seen_in_real_time(tmp_path):
    """Its pictures are small, and its pulses come at their rate."""
    path, plan = write_flow(tmp_path, pairs=100, chunk=50)
    bench = load_bench(path)
    step = load_plan(plan, bench).steps[-1]
    assert simulation_s(bench, [step])[0] > frames_s(bench, step) > 4.0
