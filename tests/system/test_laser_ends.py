"""How light ends when a program does: real processes, a box on a pseudo-terminal that counts its own pulses.

RTPIV_LASER_KILLS says how many kills -9 of everything (default 50).
"""

import os
import random
import signal
import subprocess
import sys
import time

import pytest

from daq.timing.switch_off import switch_off
from tests.slow_cases import slow
from tests.system.laser_client import table

KILLS = int(os.environ.get("RTPIV_LASER_KILLS", "50"))
PAIRS, RATE_HZ = 25, 50.0
PATIENCE_S = 120.0
LIT = ("B", "D")


class Bench:
    """A box, and a program that fires."""

    def __init__(self, folder, has_lamps, box="qc9520", rate_hz=RATE_HZ):
        self.folder, self.rate_hz = folder, rate_hz
        self.link, self.log = folder / "port", folder / "pulses.txt"
        words = [str(self.link), str(self.log), box]
        self.box = self._start("timing_box", words, "box.txt")
        self.client = self.box
        self._until(self.link.is_symlink)
        lamps = "lamps" if has_lamps else "none"
        words = [str(self.link), box, lamps, str(PAIRS), str(rate_hz)]
        self.client = self._start("laser_client", words, "client.txt")
        words = self.client.stdout.readline().split()
        assert words[:1] == ["open"], (folder / "client.txt").read_text()
        self.watchdog = int(words[1])

    def wait_for(self, word):
        while (line := self.client.stdout.readline()) and line.strip() != word:
            pass
        assert line, (self.folder / "client.txt").read_text()

    def pulses_after(self, moment_s):
        """Pulses of either Q-switch since a moment, and when the last of them was, after it."""
        lines = [line.split() for line in self.log.read_text().splitlines() if line.count(" ") == 1]
        late = [(float(time_s) - moment_s, output) for time_s, output in lines if float(time_s) > moment_s]
        lit = [each for each in late if each[1] in LIT]
        return max((sum(1 for _, o in lit if o == output) for output in LIT), default=0), max(lit, default=(0.0,))[
            0
        ]

    def end(self):
        for process in (self.client, self.box):
            if process.poll() is None:
                process.kill()
            process.wait()
            process.stdout.close()

    def _start(self, module, words, errors):
        command = [sys.executable, "-m", f"tests.system.{module}", *words]
        with (self.folder / errors).open("w") as file:
            return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=file, text=True)

    def _until(self, is_so):
        end_s = time.monotonic() + PATIENCE_S
        while not is_so() and self.box.poll() is None and time.monotonic() < end_s:
            time.sleep(0.01)
        if not is_so():
            self.end()
            raise AssertionError((self.folder / "box.txt").read_text() or "the box does not come up")


@pytest.fixture
def bench(tmp_path):
    made = []

    def make(name, has_lamps=False, **options):
        folder = tmp_path / name
        folder.mkdir()
        made.append(Bench(folder, has_lamps, **options))
        return made[-1]

    yield make
    for each in made:
        each.end()


def kill_everything(bench):
    """Program and watchdog at once; nobody is left who could say off."""
    moment_s = time.monotonic()
    for pid in (bench.watchdog, bench.client.pid):
        os.kill(pid, signal.SIGKILL)
    bench.client.wait()
    return moment_s


def test_kill_9_of_everything_leaves_at_most_a_chunk(bench):
    fires = bench("once")
    fires.wait_for("fires")
    time.sleep(0.1)
    moment_s = kill_everything(fires)
    time.sleep(PAIRS / RATE_HZ + 0.3)
    pulses, _ = fires.pulses_after(moment_s)
    assert pulses <= PAIRS
    assert fires.pulses_after(0.0)[0] > 0
    time.sleep(0.3)
    assert fires.pulses_after(moment_s)[0] == pulses


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_50_kills_at_random_times(bench, capsys):
    rng, counts = random.Random(5), []
    for number in range(KILLS):
        fires = bench(f"kill{number}", has_lamps=number % 2 == 1)
        if rng.random() < 0.8:
            fires.wait_for("fires")
        time.sleep(rng.uniform(0.0, 1.5))
        moment_s = kill_everything(fires)
        time.sleep(PAIRS / RATE_HZ + 0.5)
        counts.append(fires.pulses_after(moment_s)[0])
        fires.end()
        assert counts[-1] <= PAIRS
    with capsys.disabled():
        lit = sum(1 for count in counts if count)
        print(f"\n{KILLS} kills: {max(counts)} of {PAIRS} pulses at most, {lit} while it fired: {sorted(counts)}")
    assert max(counts) > 0


def after_the_end(bench, how, limit_s):
    """Seconds from what ends the program to the last pulse."""
    fires = bench("ends")
    fires.wait_for("fires")
    time.sleep(0.1)
    moment_s = time.monotonic()
    how(fires)
    time.sleep(0.6)
    pulses, last_s = fires.pulses_after(moment_s)
    assert last_s <= limit_s, (pulses, last_s)
    assert pulses < PAIRS - 5  # it was in the middle of a chunk
    return last_s


def signalled(*numbers):
    def send(fires):
        for number in numbers:
            fires.client.send_signal(number)

    return send


@pytest.mark.parametrize(
    "how",
    [
        pytest.param(signalled(signal.SIGTERM), id="SIGTERM", marks=pytest.mark.slow),
        pytest.param(signalled(signal.SIGINT), id="Ctrl-C"),
        pytest.param(signalled(signal.SIGINT, signal.SIGINT), id="Ctrl-C twice", marks=pytest.mark.slow),
        pytest.param(signalled(signal.SIGHUP), id="SIGHUP", marks=pytest.mark.slow),
        pytest.param(signalled(signal.SIGTSTP), id="Ctrl-Z", marks=pytest.mark.slow),
        pytest.param(signalled(signal.SIGQUIT), id="SIGQUIT", marks=pytest.mark.slow),
    ],
)
def test_a_signal_switches_off_within_100_ms(bench, how):
    after_the_end(bench, how, 0.1)


def test_the_watchdog_switches_off_after_kill_9_of_the_program(bench):
    after_the_end(bench, lambda fires: fires.client.kill(), 0.35)


BOTH = [0.4, 0.51]  # a chunk takes half a second


@pytest.mark.parametrize(
    ("has_lamps", "box", "after_s"),
    [(True, "qc9520", BOTH[:1]), (False, "pivlab_oltsync", BOTH[1:]),
     *map(slow, (True, False, False), ("qc9520", "qc9520", "pivlab_oltsync"), (BOTH,) * 3)],
)  # fmt: skip
def test_laser_off_of_another_process_ends_a_program_that_fires_chunk_after_chunk(bench, has_lamps, box, after_s):
    """In a burst, in a pause, while it arms: wherever it falls."""
    for wait_s in after_s:
        fires = bench(f"off{wait_s}", has_lamps, box=box)
        fires.wait_for("fires")
        time.sleep(wait_s)
        said = switch_off(table(str(fires.link), box, has_lamps, RATE_HZ))
        moment_s = time.monotonic()
        assert said.confirmed, said.words
        fires.client.wait(PATIENCE_S)
        time.sleep(1.0)
        assert fires.pulses_after(moment_s)[0] == 0
        assert fires.client.returncode != 0
        assert "rtpiv laser off was called" in (fires.folder / "client.txt").read_text()
