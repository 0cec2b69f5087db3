"""The command from its first line on: what a person presses while it loads."""

import subprocess
import sys

import pytest

from rtpiv.command_line.cli import INTERRUPTED

# Ctrl-C at the moment at which each of some modules is looked for.
PRESSED = """
import os, signal, sys
from rtpiv.command import main

class Pressed:
    loaded = sys.argv.pop(1).split()

    def find_spec(self, name, path=None, target=None):
        if name in self.loaded:
            os.kill(os.getpid(), signal.SIGINT)

sys.meta_path.insert(0, Pressed())
"""
LATE = "from rtpiv.command import main\nsys.exit(main())\n"


def test_ctrl_c_before_the_command_is_loaded_is_one_word(tmp_path):
    """In the script that pip makes, while the package itself is imported."""
    script = tmp_path / "rtpiv"
    script.write_text(PRESSED.replace("from rtpiv.command import main\n", "") + LATE)
    done = subprocess.run(
        [sys.executable, script, "rtpiv.neighbours", "check", "."], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (INTERRUPTED, "interrupted\n")


@pytest.mark.parametrize(
    "loaded",
    [
        "rtpiv.command_line.cli",
        "rtpiv.command_line.cli rtpiv.command_line.exit_codes",
        "rtpiv.options",
        "rtpiv.analysis.pictures.drawing_process",
        "rtpiv.verbs.trace",
    ],
)
def test_ctrl_c_while_modules_load_is_one_word(loaded, tmp_path):
    command = [sys.executable, "-c", PRESSED + LATE, loaded, "trace", "scene.yaml", "-o", str(tmp_path / "out")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (INTERRUPTED, "interrupted\n")
    assert not (tmp_path / "out").exists()
