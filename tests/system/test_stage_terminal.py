"""The prompt of `rtpiv bench stage` on a real terminal: Ctrl-C, Ctrl-D, questions, and real motions."""

import fcntl
import os
import select
import termios
import time

import pytest

from rtpiv.command_line.cli import DONE, INTERRUPTED
from tests.system.served import served_bench

CTRL_C, CTRL_D = b"\x03", b"\x04"


class Terminal:
    """A program on a terminal of its own, and what a person sees there."""

    def __init__(self, bench, *arguments):
        self.bench = bench
        self._main, near = os.openpty()
        self.process = bench.start(
            *arguments, stdin=near, stdout=near, stderr=near, start_new_session=True,
            preexec_fn=lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0),
        )  # fmt: skip
        os.close(near)
        self.seen = ""

    def expect(self, words, patience_s=120.0):
        """Wait for words behind all that was expected before."""
        end_s = time.monotonic() + patience_s
        while words not in self.seen:
            assert time.monotonic() < end_s, f"{words!r} did not come: {self.seen!r}"
            if select.select([self._main], [], [], 0.1)[0]:
                try:
                    self.seen += os.read(self._main, 65536).decode(errors="replace")
                except OSError:
                    assert words in self.seen, self.seen
        before, _, self.seen = self.seen.partition(words)
        return before

    def type(self, data):
        os.write(self._main, data if isinstance(data, bytes) else data.encode() + b"\n")

    def hang_up(self):
        os.close(self._main)
        self._main = -1

    def close(self):
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait(60)
        if self._main >= 0:
            os.close(self._main)


@pytest.fixture
def bench(tmp_path):
    with served_bench(tmp_path) as served:
        yield served


@pytest.fixture
def terminal(bench):
    opened = Terminal(bench, "bench", "stage")
    yield opened
    opened.close()


def ready_to_move(bench, terminal):
    """Home in haste, then begin a rail move of half a minute in real time."""
    bench.clock.set_speed(100.0)
    terminal.expect("stage> ")
    terminal.type("home")
    terminal.expect("stage> ")
    bench.clock.set_speed(1.0)
    terminal.type("move rail_z=800")
    bench.wait_until(lambda: bench.true_mm("rail_z") > -190.0)


@pytest.mark.slow
def test_ctrl_c_stops_holds_and_comes_back_to_the_prompt_and_a_second_one_leaves(bench, terminal):
    ready_to_move(bench, terminal)
    terminal.type(CTRL_C)
    terminal.expect("the bench is held: look at it, then `clear`")
    terminal.expect("held> ")
    bench.rests()
    rests_mm = bench.true_mm("rail_z")
    assert rests_mm < 700.0
    terminal.type("move rail_z=900")
    assert "clear the stop" in terminal.expect("held> ")
    terminal.type("jog rail_z=+5")
    assert "clear the stop" in terminal.expect("held> ")
    bench.rests()
    assert bench.true_mm("rail_z") == rests_mm
    terminal.type("clear")
    terminal.expect("stage> ")
    terminal.type("jog rail_z=+5")  # isel still knows where it is
    terminal.expect("rail_z is at")
    terminal.expect("stage> ")
    assert bench.true_mm("rail_z") == pytest.approx(rests_mm + 5.0, abs=0.1)
    terminal.type("move rail_z=800")
    bench.wait_until(lambda: bench.true_mm("rail_z") > rests_mm + 10.0)
    terminal.type(CTRL_C)
    terminal.expect("held> ")
    time.sleep(0.5)  # readline takes a Ctrl-C that comes before it waits for a key with the next key
    terminal.type(CTRL_C)
    assert terminal.process.wait(60) == INTERRUPTED
    bench.rests()
    assert bench.true_mm("rail_z") < 700.0


@pytest.mark.slow
def test_ctrl_c_at_once_again_does_not_wait_for_the_controller(bench, terminal):
    ready_to_move(bench, terminal)
    terminal.type(CTRL_C)
    time.sleep(0.05)
    terminal.type(CTRL_C)
    assert terminal.process.wait(60) == INTERRUPTED
    bench.rests()
    assert bench.true_mm("rail_z") < 700.0


@pytest.mark.slow
def test_a_closed_window_stops_what_moves(bench, terminal):
    """The kernel sends SIGHUP to what runs in front, and every write fails."""
    ready_to_move(bench, terminal)
    terminal.hang_up()
    terminal.process.wait(60)
    bench.rests()
    assert bench.true_mm("rail_z") < 700.0


@pytest.mark.slow
def test_save_asks_first(bench, terminal):
    before = bench.path.read_text()
    bench.clock.set_speed(100.0)
    terminal.expect("stage> ")
    terminal.type("home rail_z")
    terminal.expect("stage> ")
    terminal.type("here rail_z")
    terminal.expect("stage> ")
    terminal.type("save")
    terminal.expect("+scene_at_mm: {rail_z: -200.0}")
    terminal.expect("[y/N] ")
    terminal.type("")
    terminal.expect("nothing was written")
    assert bench.path.read_text() == before
    terminal.expect("stage> ")
    terminal.type("save")
    terminal.expect("[y/N] ")
    terminal.type("y")
    terminal.expect("the old file is")
    assert "scene_at_mm: {rail_z: -200.0}" in bench.path.read_text()
    terminal.expect("stage> ")
    terminal.type(CTRL_D)
    assert terminal.process.wait(60) == DONE
