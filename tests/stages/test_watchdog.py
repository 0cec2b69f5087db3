"""What no handler meets: a program killed in mid-motion, judged by where the simulated carriage comes to rest."""

import json
import os
import pty
import signal
import socket
import subprocess
import sys
import time
import tty
from pathlib import Path
from types import SimpleNamespace

import pytest

import stages.watchdog
from stages.drivers_by_name import DRIVERS
from stages.watchdog import SHORT_LIFE_S, Watchdog, needs_watchdog, word_of
from tests.slow_cases import slow
from tests.stages.children import FAR_MM, MOVE, end, go, read_line, served

TELL_PID = "said(stage._watchdog.pid); "


ENDS = [(box, number) for number in (signal.SIGKILL, signal.SIGSEGV, signal.SIGABRT) for box in DRIVERS]
FAST_ENDS = {("zaber_ascii", signal.SIGKILL), ("grbl", signal.SIGKILL)}


@pytest.mark.parametrize(("box", "number"), [end if end in FAST_ENDS else slow(*end) for end in ENDS])
def test_killed_in_motion_the_axis_stops(box, number):
    """The words of all boxes are those of `test_ended_programs`, which is fast."""
    with served(box) as world:
        child = world.start_motion()
        child.send_signal(number)
        assert child.wait(60) == -number
        end(child)
        assert world.rest_mm() < 60.0


@pytest.mark.slow
def test_without_the_watchdog_it_drives_on(driver):
    """The judge must be able to see what the watchdog prevents."""
    with served(driver) as world:
        child = world.start_motion(TELL_PID + MOVE)
        watchdog = int(read_line(child))
        child.send_signal(signal.SIGSTOP)  # it would stop the motion once it missed its watchdog
        world.wait_until(lambda: status(child.pid) == "T")
        os.kill(watchdog, signal.SIGKILL)
        child.kill()
        end(child)
        assert world.rest_mm() == pytest.approx(FAR_MM, abs=1.0)


@pytest.mark.slow
def test_killed_while_homing(driver):
    with served(driver, home_timeout_s=300.0) as world:
        child = world.start("said('homing'); stage.home(['a', 'b'])")
        motor = world.world.motors["a" if driver == "grbl" else "b"]
        begun_mm = motor.carriage_mm
        go(child)
        world.wait_until(lambda: world.true_mm() and abs(motor.carriage_mm - begun_mm) > 0.5)
        child.kill()
        end(child)
        world.rest_mm()
        rest_mm = motor.carriage_mm
        time.sleep(0.5)
        world.true_mm()
        assert motor.carriage_mm == rest_mm
        closed = motor.is_closed("low") or motor.is_closed("high")
        assert not closed, "it has homed to the end"


def test_a_forked_child_that_lives_on_keeps_neither_pipe_nor_port():
    """Its copy of the pipe's end would keep the watchdog waiting, its copy of the port the lock."""
    fork = "import os\nif os.fork() == 0:\n    time.sleep(300.0)\n    os._exit(0)\n" + MOVE
    with served("isel_dnc") as world:
        child = world.start_motion(fork, start_new_session=True)
        child.kill()
        try:
            assert child.wait(60) == -signal.SIGKILL
            assert world.rest_mm() < 60.0
        finally:
            os.killpg(child.pid, signal.SIGKILL)
            end(child)


@pytest.mark.slow
def test_another_program_on_the_port_does_not_keep_the_stop_away(driver):
    """The lock is taken the moment the killed program lets go of it."""
    import fcntl

    with served(driver) as world:
        child = world.start_motion()
        descriptor = os.open(world.offered.controllers["box"].port, os.O_RDWR | os.O_NOCTTY)
        try:
            child.kill()
            fcntl.flock(descriptor, fcntl.LOCK_EX)
            end(child)
            assert world.rest_mm() < 60.0
        finally:
            os.close(descriptor)


def test_at_rest_nothing_is_said():
    """A program killed at rest costs nobody a position: no byte is sent."""
    with served("zaber_ascii") as world:
        child = world.start(TELL_PID + "time.sleep(300.0)")
        sent = []
        line = world.world.lines["box"]
        real = line.send
        line.send = lambda data: (sent.append(data), real(data))
        go(child)
        pid = int(read_line(child))
        child.kill()
        end(child)
        world.wait_until(lambda: not Path(f"/proc/{pid}").exists() or "Z" in status(pid))
        time.sleep(0.2)
        assert sent == []


def status(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return "Z"


def test_signals_pass_it_by():
    watchdog, deadline = Watchdog(), time.monotonic() + 60.0
    try:
        pid, about = watchdog.pid, Path(f"/proc/{watchdog.pid}/status")
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT):
            while not int(about.read_text().partition("SigIgn:")[2].split()[0], 16) >> (number - 1) & 1:
                assert time.monotonic() < deadline  # a busy machine lets it begin late
                time.sleep(0.01)
            os.kill(pid, number)
        time.sleep(0.2)
        assert status(pid) not in ("Z", "X")
        assert os.getsid(pid) != os.getsid(0)
    finally:
        watchdog.close()
    while status(pid) not in ("Z", "X"):
        assert time.monotonic() < deadline
        time.sleep(0.01)


@pytest.mark.slow
def test_a_watchdog_that_was_killed_is_replaced_and_told_everything():
    with served("pi_gcs2") as world:
        child = world.start(TELL_PID + "sys.stdin.readline(); " + MOVE)
        begun_mm = world.true_mm()
        go(child)
        os.kill(int(read_line(child)), signal.SIGKILL)
        time.sleep(0.2)
        go(child)
        world.wait_until(lambda: abs(world.true_mm() - begun_mm) > 3.0)
        child.kill()
        end(child)
        assert world.rest_mm() < 60.0


def test_it_imports_nothing_heavy_and_nothing_of_ours():
    code = (
        "import sys, runpy; sys.argv = ['watchdog', '0']; sys.stdin.close; "
        f"runpy.run_path({stages.watchdog.__file__!r}, run_name='looked at'); "
        "print(sorted({name.partition('.')[0] for name in sys.modules}))"
    )
    said = subprocess.run([sys.executable, "-P", "-c", code], capture_output=True, text=True, check=True).stdout
    names = said.replace("'", '"')
    assert not set(json.loads(names)) & {"numpy", "scipy", "numba", "pydantic", "yaml", "stages", "daq", "tracer"}


@pytest.mark.posix("locks of ports")
def test_another_box_under_the_name_of_a_pulled_one_is_left_alone():
    """A pseudo-terminal's number is given out again at once, as a converter's name is."""
    for _ in range(50):
        ours, name = pty.openpty()
        url = os.ttyname(name)
        watchdog = Watchdog()
        watchdog.know("box", url, 9600, False, [b"STOP"])
        told = watchdog._known["box"]
        watchdog.close()
        os.close(ours)
        os.close(name)
        time.sleep(0.05)  # the kernel stamps what it makes with a clock that stands for up to 10 ms
        other, other_name = pty.openpty()
        if os.ttyname(other_name) == url:
            break
        os.close(other)  # another process was faster
        os.close(other_name)
    else:
        pytest.fail("no pseudo-terminal's number was ever given out again")
    stages.watchdog.stop(told)
    os.set_blocking(other, False)
    with pytest.raises(BlockingIOError):
        os.read(other, 100)
    os.close(other)
    os.close(other_name)


def test_simulated_lines_of_this_process_need_none():
    assert not needs_watchdog(["sim://box-1", "loop://"])
    assert needs_watchdog(["sim://box-1", "/dev/ttyUSB0"])
    assert needs_watchdog(["socket://10.0.0.7:4001"])


def test_the_next_watchdog_is_told_what_moved_before_the_last_one_was_killed(monkeypatch):
    """Nothing is said a second time by who moves: what moves already would drive on."""
    pipes = []

    def start(self):
        reader, writer = os.pipe()
        pipes.append(os.fdopen(reader, "rb"))
        os.set_blocking(reader, False)
        self._process = SimpleNamespace(stdin=os.fdopen(writer, "wb", buffering=0), wait=lambda: 0, pid=0)

    monkeypatch.setattr(Watchdog, "_start", start)
    monkeypatch.setattr(stages.watchdog, "needs_watchdog", lambda urls: True)
    watchdog = Watchdog()
    watchdog.know("rail", "/dev/none", 9600, False, [b"stop"])
    watchdog.moves("rail")
    pipes[0].close()  # somebody has killed it
    watchdog.know("laser", "/dev/other", 9600, False, [b"off"])
    told = [json.loads(line) for line in pipes[1].read().splitlines()]
    watchdog.close()
    pipes[1].close()
    assert [word["know"] for word in told if "know" in word] == ["rail", "laser"]
    assert {"moves": "rail"} in told


def test_stop_is_said_again_for_a_while_because_it_may_overtake_what_is_not_read_yet():
    """Judged by when the bytes come: a box that reads a command 0.1 s late obeys only what comes behind that."""
    ours, theirs = pty.openpty()
    tty.setraw(theirs)
    begun_s = time.monotonic()
    assert stages.watchdog.stop(word_of("box", os.ttyname(theirs), 9600, False, [b"s"]))
    assert time.monotonic() - begun_s < 5.0
    os.set_blocking(ours, False)
    said = os.read(ours, 100)
    os.close(ours)
    os.close(theirs)
    assert len(said) >= 4
    assert time.monotonic() - begun_s > 0.3


@pytest.mark.parametrize("is_watched", [True, False])
def test_what_the_watchdog_says_ends_a_reference_run_of_a_grbl_board(bench, is_watched):
    """A cancel of jogs does not: only a reset ends `$H`, and the watchdog does not know what was begun."""
    made = bench("grbl", sim={"power_up_mm": 100.0})
    made.controller.token = made.stage.latch.begin()
    made.controller.start_home("X")
    made.clock.sleep_s(0.3)
    before_mm = made.world.true_mm("a"), made.world.true_mm("b")
    for data in made.controller.watchdog_bytes() if is_watched else ():
        made.line.send(data)
    made.clock.sleep_s(10.0)
    moved_mm = [abs(made.world.true_mm(axis) - mm) for axis, mm in zip("ab", before_mm, strict=True)]
    assert max(moved_mm) < 3.0 if is_watched else moved_mm[0] > 10.0


def test_where_pipes_cannot_be_selected_the_end_of_the_pipe_is_the_death():
    """As on Windows: the process waits in a read, and whatever moves is stopped when that ends."""
    begin = "import sys, stages.watchdog as w; w.SELECTS_PIPES = False; w.watch(int(sys.argv[1]))"
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(20.0)
        url = f"socket://127.0.0.1:{server.getsockname()[1]}"
        process = subprocess.Popen([sys.executable, "-c", begin, str(os.getpid())], stdin=subprocess.PIPE)
        for word in (word_of("rail", url, 19200, False, [b"\xfd"]), {"moves": "rail"}):
            process.stdin.write(json.dumps(word).encode() + b"\n")
            process.stdin.flush()
        process.stdin.close()
        port, _ = server.accept()
        port.settimeout(20.0)
        assert port.recv(1) == b"\xfd"
        port.close()
        process.wait(20)


@pytest.mark.posix("kill -9")
def test_a_watchdog_that_is_killed_is_missed_at_once_and_one_that_is_closed_is_not():
    missed = []
    watchdog = Watchdog(lambda why: missed.append((time.monotonic(), why)))
    time.sleep(SHORT_LIFE_S + 0.3)
    killed_s, pid = time.monotonic(), watchdog.pid
    os.kill(pid, signal.SIGKILL)
    while not missed and time.monotonic() < killed_s + 5.0:
        time.sleep(0.01)
    assert missed[0][0] - killed_s < 0.1
    assert watchdog.pid not in (None, pid)
    watchdog.close()
    time.sleep(0.3)
    assert len(missed) == 1


@pytest.mark.posix("kill -9")
def test_a_motion_whose_watchdog_is_killed_is_stopped():
    with served("zaber_ascii") as world:
        child = world.start_motion(TELL_PID + MOVE)
        os.kill(int(read_line(child)), signal.SIGKILL)
        assert world.rest_mm() < 60.0
        assert child.wait(60) == 1
        assert "MotionStopped: the watchdog of this program was killed" in end(child)[2]
