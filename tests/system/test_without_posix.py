"""A computer without POSIX (Windows): what its Python lacks is asked for where it is used, or not at all.

What a real Windows does is not seen here.  Seen is that no module of the packages needs what is missing there to
be imported, but for those that serve it, and that a run and its calibration work on a simulated bench with those
modules hidden from our code: stages and camera in the process, no terminals, no library of a camera.
"""

import ast
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from tests.no_posix.lacking import FUNCTIONS, MODULES, PACKAGES

ROOT = Path(__file__).resolve().parents[2]
NEED_THEM = {  # simulated hardware that real client libraries talk to; `SimulatedBench` imports them when asked
    Path("sim/emulators/pty.py"), Path("sim/camera/gentl/modules.py"),
}  # fmt: skip


@pytest.fixture(scope="module")
def parsed():
    names = (*MODULES, *(name for those in FUNCTIONS.values() for name in those))
    lacking = re.compile(rf"\b({'|'.join(map(re.escape, names))})\b")
    texts = [
        (path.relative_to(ROOT), path.read_text(encoding="utf-8"))
        for package in PACKAGES
        for path in sorted((ROOT / package).rglob("*.py"))
    ]
    return [(path, ast.parse(text)) for path, text in texts if lacking.search(text)]


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


def test_no_module_needs_posix_to_be_imported(parsed):
    found = {
        (str(path), name)
        for path, tree in parsed
        if path not in NEED_THEM
        for name in imported_at_once(tree)
        if name.partition(".")[0] in MODULES
    }
    assert not found


def run_at_once(tree):
    """Every node that importing a module runs: what stands in functions and behind conditions may be guarded."""
    waiting = [tree]
    while waiting:
        node = waiting.pop()
        yield node
        if isinstance(node, ast.FunctionDef):
            waiting += [*node.decorator_list, *node.args.defaults, *filter(None, node.args.kw_defaults)]
        elif not isinstance(node, ast.Lambda | ast.If):
            waiting += ast.iter_child_nodes(node)


def test_nothing_of_posix_is_called_as_modules_are_imported(parsed):
    found = {
        (str(path), node.attr)
        for path, tree in parsed
        for node in run_at_once(tree)
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name)
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
def test_a_run_and_its_calibration_without_posix(bench):
    environment = os.environ | {"PYTHONPATH": f"{ROOT / 'tests/no_posix'}{os.pathsep}{ROOT}"}

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
    assert "No module named" in hidden.stderr  # else nothing would be shown below
    rtpiv("acquire", "plan-target.yaml", "--bench", "bench.yaml", "--simulate", "--home")
    (run,) = (bench.parent / "runs").glob("*_plan-target")
    assert "through glass" in rtpiv("calibrate", str(run), "-o", "fit")
