"""Pictures drawn apart: what is sent is drawn there, errors come back, and nothing depends on the child."""

import os
import signal
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from rtpiv.analysis.pictures import drawing_process
from rtpiv.command_line.cli import DRAWS

ROOT = Path(__file__).resolve().parents[4]
HERE = "tests.rtpiv.analysis.pictures.test_drawing_process"
RUN = """
import sys
from pathlib import Path
from rtpiv.analysis.pictures import drawing_process
def go(out):
    with drawing_process.drawing_apart(("json",)):
        {}
go(Path(sys.argv[1]))
"""


def draw_pid(path):
    """Draw who draws."""
    path.write_text(str(os.getpid()))


def fail(path):
    """Draw nothing."""
    raise OSError(28, "no space left on device", str(path))


def ended(folder, body):
    """A process that draws apart, as a command does: this one has threads of the test runner."""
    text = RUN.format(body.replace("\n", "\n        "))
    command = [sys.executable, "-c", text, str(folder)]
    run = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    out, err = run.communicate(timeout=60)
    return run, out, err


pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="elsewhere pictures are drawn by who asks")


def test_what_is_imported_ahead_is_there():
    """A name that is no more ends the child's imports, and then the verb waits for what it draws with."""
    for verb, modules in DRAWS.items():
        assert all(find_spec(module) for module in modules), verb


def test_who_asks_draws_where_nobody_else_does(tmp_path):
    with drawing_process.drawing() as draw:
        draw(f"{HERE}:draw_pid", tmp_path / "a")
    assert (tmp_path / "a").read_text() == str(os.getpid())


def test_who_is_patient_draws_last(tmp_path):
    with drawing_process.drawing(patient=True) as draw:
        draw(f"{HERE}:draw_pid", tmp_path / "a")
        assert not (tmp_path / "a").exists()
    assert (tmp_path / "a").read_text() == str(os.getpid())


@pytest.mark.posix("a fork")
def test_another_process_draws_and_is_gone_afterwards(tmp_path, monkeypatch):
    monkeypatch.setenv("RTPIV_THREADS", "2")
    body = f"with drawing_process.drawing() as draw:\n    [draw('{HERE}:draw_pid', out / name) for name in 'abc']"
    run, _, err = ended(tmp_path, body)
    assert run.returncode == 0, err
    pids = {(tmp_path / name).read_text() for name in "abc"}
    assert len(pids) == 1
    assert str(run.pid) not in pids
    assert not Path(f"/proc/{pids.pop()}").exists()


WHEN_FORKED = """
import sys
from rtpiv.analysis.pictures import drawing_process
from rtpiv.command_line.cli import main
def forked(modules):
    print(*(name in sys.modules for name in ("rtpiv.verbs.trace", "numba", "matplotlib")))
    raise KeyboardInterrupt
drawing_process.drawing_apart = forked
main(["trace", "scene.yaml"])
"""


@pytest.mark.slow
def test_what_both_need_is_imported_before_they_part():
    run = subprocess.run([sys.executable, "-c", WHEN_FORKED], cwd=ROOT, capture_output=True, text=True, check=True)
    assert run.stdout.split() == ["True", "True", "False"]


def test_errors_come_back(tmp_path, monkeypatch):
    monkeypatch.setenv("RTPIV_THREADS", "2")
    body = f"with drawing_process.drawing() as draw:\n    draw('{HERE}:fail', out)\n"
    body += f"    draw('{HERE}:draw_pid', out / 'a')"
    run, _, err = ended(tmp_path, body)
    assert run.returncode == 1
    assert err.rstrip().endswith(f"OSError: [Errno 28] no space left on device: '{tmp_path}'")


@pytest.mark.posix("a fork")
@pytest.mark.parametrize("when", ["before", "after"])
def test_what_a_killed_child_leaves_undone_is_drawn_here(tmp_path, monkeypatch, when):
    monkeypatch.setenv("RTPIV_THREADS", "2")
    child = "drawing_process._process._process"
    kill = f"import os; os.kill({child}.pid, {int(signal.SIGKILL)}); {child}.join()"
    drawn = f"    [draw('{HERE}:draw_pid', out / name) for name in 'ab']"
    first = [kill] if when == "before" else []
    last = [f"    {kill}"] if when == "after" else []
    body = "\n".join([*first, "with drawing_process.drawing() as draw:", drawn, *last])
    run, _, err = ended(tmp_path, body)
    assert run.returncode == 0, err
    if when == "before":
        assert (tmp_path / "a").read_text() == str(run.pid)
    assert (tmp_path / "b").exists()


def test_one_core_draws_itself(tmp_path, monkeypatch):
    monkeypatch.setenv("RTPIV_THREADS", "1")
    run, _, err = ended(
        tmp_path, f"with drawing_process.drawing() as draw:\n    draw('{HERE}:draw_pid', out / 'a')"
    )
    assert (tmp_path / "a").read_text() == str(run.pid), err


@pytest.mark.posix("a fork")
def test_a_killed_command_leaves_no_child(tmp_path, monkeypatch):
    monkeypatch.setenv("RTPIV_THREADS", "2")
    body = "print(drawing_process._process._process.pid, flush=True)\nimport os; os.kill(os.getpid(), 9)"
    run, out, _ = ended(tmp_path, body)
    assert run.returncode == -9
    for _ in range(200):
        if not Path(f"/proc/{int(out)}").exists():
            return
        signal.sigtimedwait([], 0.05)
    raise AssertionError("the child outlives who started it")


HUNG_UP = """
import os, signal
from daq.signal_handling import handle_signals
from rtpiv.analysis.pictures import drawing_process
drawing_process._worth_it = lambda: True
os.register_at_fork(after_in_child=lambda: os.kill(os.getpid(), signal.SIGHUP))
with handle_signals(), drawing_process.drawing_apart(("json",)):
    print("alive")
"""


@pytest.mark.posix("a fork")
def test_a_window_closed_while_the_child_is_made_ends_it_without_a_word():
    done = subprocess.run([sys.executable, "-c", HUNG_UP], cwd=ROOT, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "alive\n", "")
