"""SIGTERM and SIGHUP end any verb as an error would: what was begun is put away, and nobody sees a traceback."""

import contextlib
import os
import pty
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from daq.signal_handling import SIGNALLED, handle_signals

# A verb that has a temporary file open and works for a long time; said to begin when it does.
CHILD = """
import sys, time
from pathlib import Path
import rtpiv.verbs.trace as verb
from rtpiv.command_line.cli import main
from ground.whole_file import whole_file

def trace(scene, out, **options):
    with whole_file(Path(out)) as stream:
        stream.write(b"half")
        print("begun", flush=True)
        while True:
            print("still at work", flush=True)
            time.sleep(0.01)

verb.trace = trace
sys.exit(main(["trace", "scene.yaml", "-o", sys.argv[1]]))
"""


@pytest.mark.slow
def test_a_verb_that_is_told_to_end_leaves_nothing_half_written(tmp_path):
    command = [sys.executable, "-c", CHILD, str(tmp_path / "out")]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    process.stdout.readline()
    process.send_signal(signal.SIGTERM)
    process.send_signal(signal.SIGTERM)  # those who close a session send several
    errors = process.communicate(timeout=60)[1]
    assert process.returncode == SIGNALLED + signal.SIGTERM
    assert "Traceback" not in errors
    assert not list(tmp_path.iterdir())


@pytest.mark.posix("SIGHUP")
def test_a_window_that_is_closed_ends_a_verb(tmp_path):
    """The terminal goes, then every word to it fails: no traceback anywhere, no temporary file left."""
    errors = tmp_path / "errors"
    pid, terminal = pty.fork()
    if pid == 0:
        os.environ["PYTHONFAULTHANDLER"] = "1"
        sys.stderr.flush()
        code = f"import sys, os; sys.stderr = open({str(errors)!r}, 'w', buffering=1)\n{CHILD}"
        os.execv(sys.executable, [sys.executable, "-c", code, str(tmp_path / "out")])
    with contextlib.suppress(OSError):
        while b"begun" not in os.read(terminal, 4096):
            pass
    os.close(terminal)
    status = os.waitpid(pid, 0)[1]
    assert os.waitstatus_to_exitcode(status) == SIGNALLED + signal.SIGHUP, errors.read_text()
    assert "Traceback" not in errors.read_text()
    assert [path.name for path in tmp_path.iterdir()] == ["errors"]


def test_handlers_are_put_back():
    before = [signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGHUP)]
    with handle_signals():
        assert signal.getsignal(signal.SIGTERM) not in before
    assert [signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGHUP)] == before


def test_what_is_ignored_stays_ignored(monkeypatch):
    """Under nohup."""
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with handle_signals():
            signal.raise_signal(signal.SIGHUP)
    finally:
        signal.signal(signal.SIGHUP, before)


def test_standard_output_on_a_full_disk_is_one_sentence(tmp_path):
    command = [sys.executable, "-m", "rtpiv.command_line.cli", "setup", "schema", "-o", str(tmp_path)]
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, check=False, timeout=250)
    assert done.returncode == 3
    assert "no space left on device; make room" in done.stderr
    assert len(done.stderr.splitlines()) == 1
