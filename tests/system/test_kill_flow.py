"""kill -9 of everything while `rtpiv acquire` fires lamps and Q-switches: the box ends by its own count.

The bench lives in a process of its own (`lit_bench`), on device files, in real time; its timing unit arms bursts
by RUN and writes down every pulse.  A run of the command line is begun in a pseudo-terminal, where the code is
typed that it asks for.  Killed at once: the program, its watchdog and the camera's process, so that nobody is left
who could say off.  RTPIV_FLOW_KILLS says how often (default 8, half a minute each).
"""

import os
import random
import re
import signal
import subprocess
import sys
import threading
import time

import pytest
import yaml

from daq.runs.pairs import pairs_of
from tests.daq.flow_bench import write_flow
from tests.system.served import children_of

pytest.importorskip("harvesters", reason="the camera needs harvesters (extra rtpiv[camera])")

KILLS = int(os.environ.get("RTPIV_FLOW_KILLS", "8"))
PAIRS, CHUNK, RATE_HZ = 100, 20, 25.0
LIT = ("B", "D")
PATIENCE_S = 180.0
AXIS = {
    "controller": "target", "channel": "1/1", "carries": "target", "along": "z", "steps_per_mm": 3200.0,
    "offset_mm": -35.0, "limits_mm": [-34.0, 20.0], "speed_mm_s": 50.0, "acceleration_mm_s2": 500.0,
    "settle_s": 0.1, "approach": {"side": "from_below", "distance_mm": 0.3, "speed_mm_s": 10.0},
}  # fmt: skip


class LitBench:
    """The bench, and one run after the other on it."""

    def __init__(self, folder):
        self.folder, self.links = folder, folder / "links"
        path, _ = write_flow(folder, pairs=PAIRS, chunk=CHUNK)
        tree = yaml.safe_load(path.read_text())
        controller = {"driver": "zaber_ascii", "port": str(self.links / "target")}
        tree["stages"] = {
            "controllers": {"target": controller}, "axes": {"target_z": AXIS}, "home_order": ["target_z"],
        }  # fmt: skip
        tree["simulation"]["axes"] = {"target_z": {"lead_mm": 4.0, "steps_per_rev": 12800, "travel_mm": 60.0}}
        del tree["simulation"]["firmware"], tree["glass"]
        tree["devices"]["laser"]["port"] = str(self.links / "laser")
        tree["camera"]["options"] = {"cti": str(self.links / "camera.cti")}
        path.write_text(yaml.safe_dump(tree, sort_keys=False))
        self.links.mkdir()
        with (folder / "bench.txt").open("w") as errors:
            words = [sys.executable, "-m", "tests.system.lit_bench", str(folder)]
            self.process = subprocess.Popen(words, stderr=errors)
        self._until((self.links / "ready").exists, "the bench does not come up")
        self.runs = 0

    def close(self):
        self.process.kill()
        self.process.wait()

    def acquire(self):
        """Begin a run; the code is typed as soon as it is asked for."""
        self.runs += 1
        return Typed(self.folder, f"runs{self.runs}")

    def pulses_since(self, moment_s=0.0):
        """The most pulses of either Q-switch since a moment."""
        lines = [line.split() for line in (self.folder / "pulses.txt").read_text().splitlines() if " " in line]
        lit = [output for time_s, output in lines if float(time_s) > moment_s]
        return max(lit.count(output) for output in LIT)

    def _until(self, is_so, why):
        end_s = time.monotonic() + PATIENCE_S
        while not is_so() and time.monotonic() < end_s and self.process.poll() is None:
            time.sleep(0.02)
        assert is_so(), f"{why}: {(self.folder / 'bench.txt').read_text()}"


class Typed:
    """`rtpiv acquire` in a terminal at which somebody types the code."""

    def __init__(self, folder, runs):
        self.runs, self.said = folder / runs, ""
        self._terminal, end = os.openpty()
        command = [
            sys.executable, "-m", "rtpiv.command_line.cli", "acquire", "plan-flow.yaml", "-o", runs, "--home",
            "--no-correct",
        ]  # fmt: skip
        where = {"cwd": folder, "env": os.environ | {"TERM": "dumb", "NO_COLOR": "1", "TMPDIR": str(folder)}}
        self.process = subprocess.Popen(command, stdin=end, stdout=end, stderr=end, **where)
        os.close(end)
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self):
        answered = False
        while True:
            try:
                self.said += os.read(self._terminal, 65536).decode(errors="replace")
            except OSError:  # the other end is gone
                return
            if not answered and (code := re.search(r"type this code: (\d{4})\s", self.said)):
                answered = True
                os.write(self._terminal, f"{code[1]}\n".encode())

    def kill_everything(self):
        """The program and all that it has started, at once; return when."""
        everybody = [self.process.pid]
        for number in everybody:
            everybody += children_of(number)
        moment_s = time.monotonic()
        for number in reversed(everybody):  # the watchdog before whom it watches, or it says off
            os.kill(number, signal.SIGKILL)
        self.end()
        return moment_s

    def end(self):
        self.process.wait(timeout=PATIENCE_S)
        self._reader.join(timeout=5.0)
        os.close(self._terminal)
        return self.process.returncode


@pytest.fixture
def bench(tmp_path):
    made = LitBench(tmp_path)
    yield made
    made.close()


@pytest.mark.slow
@pytest.mark.timeout(7200)
def test_kills_of_everything_while_a_run_fires(bench, capsys):
    rng, counts = random.Random(11), []
    for number in range(KILLS):
        before, run = bench.pulses_since(), bench.acquire()
        want = before + rng.choice((0, 1, 5, 19, 20, 21, 45, 70))
        end_s = time.monotonic() + PATIENCE_S
        while bench.pulses_since() <= want and run.process.poll() is None and time.monotonic() < end_s:
            time.sleep(0.01)
        assert run.process.poll() is None, (number, run.said[-2000:])
        time.sleep(rng.uniform(0.0, 0.3))
        moment_s = run.kill_everything()
        time.sleep(CHUNK / RATE_HZ + 0.5)
        counts.append(bench.pulses_since(moment_s))
        assert counts[-1] <= CHUNK, (number, counts)
        time.sleep(1.0)
        assert bench.pulses_since(moment_s) == counts[-1], "it goes on"
    with capsys.disabled():
        lit = sum(1 for count in counts if count)
        print(f"\n{KILLS} kills: {max(counts)} of {CHUNK} pulses at most, {lit} while it fired: {sorted(counts)}")
    assert max(counts) > 0


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_whole_run_with_lamps_has_all_pairs_and_none_too_many(bench):
    """On a box that arms by RUN, asked over a device file."""
    run = bench.acquire()
    assert run.end() == 0, run.said[-3000:]
    assert bench.pulses_since() == PAIRS
    (path,) = run.runs.glob("*_plan-flow")
    found = pairs_of(path)
    assert len(found.pairs) == PAIRS
    assert found.alone == ()
