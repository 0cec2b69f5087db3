"""The command from its first line on: what a person presses while it loads."""

import subprocess
import sys

import pytest

from rtpiv.command_line.cli import DONE, INTERRUPTED, USAGE
from tests.loops import loop_over

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


@loop_over(
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


# What Python would take apart at its end says so; so does what is to be called there, and a thread that is late.
TORN = """
import atexit, os, sys, threading, time
from rtpiv.command import run

class Torn:
    def __del__(self, write=os.write):
        write(1, b"torn apart\\n")

def late():
    time.sleep(0.2)
    sys.stdout.write("thread\\n")

if sys.argv.pop(1) == "before":
    atexit.register(sys.stdout.write, "called last\\n")
    sys.stdout.flush()
held = Torn()
import rtpiv.command_line.cli as cli
carry_out = cli.main

def main(arguments):
    threading.Thread(target=late).start()
    atexit.register(sys.stdout.write, "called\\n")
    return carry_out(arguments)

cli.main = main
sys.exit(run())
"""
SCENE = "camera: {f_mm: 60.0, L_mm: 500.0, pixel_pitch_um: 11.0, sensor_px: [64, 64]}\nwavelength_nm: 532\n"


@pytest.mark.parametrize(
    ("before", "scene", "code", "end"),
    [
        ("nothing", SCENE, DONE, ["thread", "called"]),
        ("nothing", SCENE.replace("60.0", "sixty"), USAGE, ["thread", "called"]),
        ("before", SCENE, DONE, ["thread", "called", "called last", "torn apart"]),
    ],
    ids=["right", "wrong", "measured"],
)
def test_a_verb_that_is_done_ends_its_process_at_once(before, scene, code, end, tmp_path):
    """Nothing is taken apart; all else that Python does at the end is done, for who came first in its own way."""
    (tmp_path / "scene.yaml").write_text(scene)
    command = [sys.executable, "-c", TORN, before, "check", "scene.yaml"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path)
    assert done.returncode == code, done.stderr
    lines = done.stdout.splitlines()
    assert [line for line in lines if "scene.yaml" not in line] == end


def test_a_reader_who_leaves_is_no_error_of_ours(tmp_path):
    """The end of a process whose reader has gone is what `flush_or_leave` makes of it."""
    (tmp_path / "scene.yaml").write_text(SCENE)
    words = [sys.executable, "-m", "rtpiv", "check", "scene.yaml"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, cwd=tmp_path) as process:
        process.stdout.close()
        said = process.stderr.read().decode()
    assert "Exception" not in said
    assert "Traceback" not in said
