"""A computer without POSIX (Windows): what its Python lacks is asked for where it is used, or not at all.

What a real Windows does is not seen here.  Seen is that no module of the packages needs what is missing there to
be imported, but for those that serve it, and that a run and its calibration work on a simulated bench with those
modules hidden from our code: stages and camera in the process, no terminals, no library of a camera.
"""

import ast
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("correction", "daq", "ground", "piv", "rtpiv", "sim", "stages", "tracer")
MODULES = {"fcntl", "grp", "pty", "pwd", "resource", "syslog", "termios", "tty"}
NEED_THEM = {  # simulated hardware that real client libraries talk to; `SimulatedBench` imports them when asked
    Path("sim/emulators/pty.py"), Path("sim/camera/gentl/modules.py"),
}  # fmt: skip
FUNCTIONS = {
    "os": {"fork", "getgid", "getloadavg", "geteuid", "getuid", "killpg", "mkfifo", "nice", "openpty",
           "posix_fadvise", "register_at_fork", "sched_getaffinity", "setpriority", "setsid", "statvfs", "sysconf",
           "uname", "wait4"},
    "signal": {"SIGALRM", "SIGHUP", "SIGKILL", "SIGQUIT", "SIGSTOP", "SIGTSTP", "SIGUSR1", "alarm", "setitimer"},
    "socket": {"AF_UNIX"},
}  # fmt: skip
HIDDEN = f"""
import builtins
before = builtins.__import__
def imported(name, globals=None, locals=None, fromlist=(), level=0):
    asks = (globals or {{}}).get("__name__", "").partition(".")[0]
    if level == 0 and name.partition(".")[0] in {MODULES!r} and asks in {PACKAGES!r}:
        raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
    return before(name, globals, locals, fromlist, level)
builtins.__import__ = imported
"""


def parsed():
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            yield path.relative_to(ROOT), ast.parse(path.read_text(encoding="utf-8"))


def imported_at_once(tree):
    """Names of modules that importing this one imports, but for those whose absence it expects."""
    waiting = list(tree.body)
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.Import):
            yield from (name.name for name in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            yield node.module
        elif isinstance(node, ast.ClassDef | ast.If | ast.With):
            waiting += node.body


def test_no_module_needs_posix_to_be_imported():
    found = {
        (str(path), name)
        for path, tree in parsed()
        if path not in NEED_THEM
        for name in imported_at_once(tree)
        if name.partition(".")[0] in MODULES
    }
    assert not found


def test_nothing_of_posix_is_called_as_modules_are_imported():
    """A call that stands in a function may be guarded; one in a module's body must be."""
    found = set()
    for path, tree in parsed():
        inside = {id(node) for outer in ast.walk(tree) if isinstance(outer, ast.FunctionDef | ast.Lambda | ast.If)
                  for node in ast.walk(outer) if node is not outer}  # fmt: skip
        found |= {
            (str(path), node.attr)
            for node in ast.walk(tree)
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and id(node) not in inside
            if node.attr in FUNCTIONS.get(node.value.id, ())
        }
    assert not found


@pytest.fixture
def bench(tmp_path):
    """The demo's lab, with its camera in memory."""
    shutil.copytree(ROOT / "examples/demo", tmp_path / "lab")
    path = tmp_path / "lab/bench.yaml"
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace("simulation:", "simulation:\n  camera_transport: memory", 1), encoding="utf-8")
    assert yaml.safe_load(path.read_text(encoding="utf-8"))["simulation"]["camera_transport"] == "memory"
    return path


@pytest.mark.slow
def test_a_run_and_its_calibration_without_posix(bench, tmp_path):
    (tmp_path / "sitecustomize.py").write_text(HIDDEN, encoding="utf-8")
    environment = os.environ | {"PYTHONPATH": f"{tmp_path}{os.pathsep}{ROOT}"}

    def rtpiv(*words):
        done = subprocess.run(
            [sys.executable, "-m", "rtpiv", *words],
            cwd=bench.parent,
            env=environment,
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    hidden = subprocess.run(
        [sys.executable, "-c", "import sim.emulators.pty"], env=environment, capture_output=True, text=True
    )
    assert "No module named 'tty'" in hidden.stderr  # else nothing would be shown below
    rtpiv("acquire", "plan-target.yaml", "--bench", "bench.yaml", "--simulate", "--home")
    (run,) = (bench.parent / "runs").glob("*_plan-target")
    assert "through glass" in rtpiv("calibrate", str(run), "-o", "fit")
