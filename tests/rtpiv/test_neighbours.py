"""A user's sim.py and daq.py beside the script: theirs and ours both work, in any order, and none runs unasked."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
OURS = "from rtpiv import load_scene; from sim.mechanics.clock import PacedClock; import daq.errors\n"
THEIRS = "import sim; from sim import doubled; import daq; print(sim.my_flow(), doubled(2), daq.CARD)\n"
SAID = "flow 4 card\n"


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "sim.py").write_text(
        "print('sim ran')\ndef my_flow(): return 'flow'\ndef doubled(x): return 2 * x\n"
    )
    (tmp_path / "daq.py").write_text("import sim\nCARD = 'card'\n")
    for name in ("tracer.py", "stages.py", "ground.py", "correction.py", "benchmarks.py"):
        (tmp_path / name).write_text("raise SystemExit('nobody asked for this file')\n")
    return tmp_path


def python(folder, *words, **environment):
    clean = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    ran = subprocess.run(
        [sys.executable, *map(str, words)],
        cwd=folder,
        env={**clean, "PYTHONPATH": str(ROOT), **environment},
        capture_output=True,
        text=True,
        check=False,
    )
    assert ran.returncode == 0, ran.stderr
    return ran.stdout


@pytest.mark.parametrize("script", [THEIRS + OURS, OURS + THEIRS + OURS])
def test_both_in_one_script(folder, script):
    (folder / "script.py").write_text(script)
    assert python(folder, "script.py") == "sim ran\n" + SAID


def test_a_file_that_nobody_asks_for_does_not_run(folder):
    (folder / "script.py").write_text(
        OURS + "import tracer, stages, ground\nprint(hasattr(tracer, '__wrapped__'))"
    )
    assert python(folder, "script.py") == "False\n"


def test_a_script_called_like_a_package(folder):
    (folder / "daq.py").write_text(
        "from rtpiv import load_scene\nfrom daq.errors import DaqError\nprint('once')\n"
    )
    assert python(folder, "daq.py") == "once\n"


def test_a_folder_of_results_called_like_a_package(tmp_path):
    (tmp_path / "sim").mkdir()
    (tmp_path / "script.py").write_text("import rtpiv, sim.mechanics.clock; print(sim.mechanics.clock.__name__)\n")
    assert python(tmp_path, "script.py") == "sim.mechanics.clock\n"


def test_a_package_of_a_user_keeps_its_own_modules(tmp_path):
    (tmp_path / "sim").mkdir()
    (tmp_path / "sim" / "__init__.py").write_text("from sim.wake import WAKE\n")
    (tmp_path / "sim" / "wake.py").write_text("WAKE = 5\n")
    (tmp_path / "script.py").write_text(
        "import rtpiv, sim.mechanics.clock, sim.wake; print(sim.WAKE, sim.wake.WAKE)\n"
    )
    assert python(tmp_path, "script.py") == "5 5\n"


def test_an_error_in_a_user_s_file_is_theirs_and_comes_again(folder):
    (folder / "sim.py").write_text("1 / 0\n")
    (folder / "script.py").write_text(
        "import rtpiv, sim\n"
        "for _ in range(2):\n    try:\n        sim.x\n    except ZeroDivisionError:\n        print('theirs')\n"
        "from sim.mechanics.clock import PacedClock\n"
    )
    assert python(folder, "script.py") == "theirs\ntheirs\n"


@pytest.mark.parametrize("words", [("-m", "rtpiv"), ("-c", "import sys; from rtpiv.command import main; main()")])
def test_the_command(folder, words):
    places = os.pathsep.join((str(folder), str(ROOT)))
    assert "trace" in python(folder, *words, "--help", PYTHONPATH=places)


def test_children_find_ours(folder):
    (folder / "script.py").write_text(
        "import rtpiv, subprocess\nfrom daq.child import child\n"
        "command, environment = child('rtpiv.command_line.cli', '--help')\n"
        "print(subprocess.run(command, env=environment, check=True, capture_output=True, text=True).stdout)\n"
    )
    assert "trace" in python(folder, "script.py")
