"""A full disk, no permission, no memory, no cache: one sentence in every verb, and nothing half-written."""

import errno
import json
import os
import resource
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import tifffile

from ground.errors import MemoryShort
from ground.memory import free_bytes, require_memory
from rtpiv.command_line.cli import DEVICE, DONE, USAGE, main
from rtpiv.options import parser_of
from rtpiv.options.command import commands
from tests.rtpiv.test_cli import SMALL
from tests.slow_cases import slow

WORDS = {
    "trace": ["scene.yaml"], "calibrate": ["folder", "-o", "out"],
    "calibrate --join": ["a", "b"],
    "correct": ["a.tif", "--scene", "s", "-o", "out"],
    "evaluate": ["a.tif", "b.tif", "--scene", "s", "-o", "out"], "focus": ["run"], "mean --join": ["a", "b"],
    "mean": ["run"], "report": ["run"], "acquire": ["plan"], "acquire --resume": ["run"], "check": ["run"],
    "bench stage": [], "laser": [], "bench camera": ["list"], "doctor": [], "doctor --probe": ["/dev/one"],
    "init": ["--yes"], "setup examples": [],
    "campaign": ["plan", "run", "--scene", "s", "-o", "out"],
    "sheet": ["run", "--scene", "s", "-o", "out"],
    "compare": ["--lenses-mm", "50", "--distances-mm", "500", "--balls-mm", "40"],
    "export": ["a.nc", "--to", "matlab"], "align": ["plan"], "bench live": [],
    "setup schema": [], "setup target": ["--paper", "A4"], "bench emulate": ["bench"], "demo": [],
    "setup mask": ["a.tif"], "mean --line": ["0", "0", "1", "1", "series"],
}  # fmt: skip


def failing(verb, monkeypatch, error):
    """Let a verb be one that meets an error of the system somewhere inside."""

    def fails(*words, **options):
        raise error

    __import__(f"rtpiv.verbs.{verb}")
    monkeypatch.setattr(sys.modules[f"rtpiv.verbs.{verb}"], verb, fails)


ERRORS = [
    (OSError(errno.ENOSPC, "No space left on device"), "no space left on device; make room"),
    (OSError(errno.EFBIG, "File too large", "out/a.png"), "out/a.png: file too large; make room"),
    (OSError(errno.EROFS, "Read-only file system", "out"), "out: read-only file system; give another path"),
    (PermissionError(errno.EACCES, "Permission denied", "out"), "out: permission denied; give another path"),
    (OSError(errno.EIO, "Input/output error"), "input/output error; give another path"),
    (MemoryError("Unable to allocate 6.71 GiB"), "not enough memory (unable to allocate 6.71 GiB); end other"),
    (MemoryError(), "not enough memory; end other programs"),
    (MemoryShort("a map needs about 9.0 GB of memory, and 1.0 GB are free"), "a map needs about 9.0 GB"),
]


def test_every_verb_says_it_in_one_sentence(monkeypatch, capsys):
    """All verbs, and all errors several times over: one clause takes them, whichever the verb."""
    for number, verb in enumerate(sorted(WORDS)):
        error, words = ERRORS[number % len(ERRORS)]
        failing(commands()[verb], monkeypatch, error)
        code = main([*verb.split(), *WORDS[verb]])
        assert code == (USAGE if error.args and error.args[0] in (errno.EROFS, errno.EACCES) else DEVICE), verb
        said = capsys.readouterr().err
        assert said.startswith(f"rtpiv {verb}: "), said
        assert words in said
        assert len(said.splitlines()) == 1
    assert len(WORDS) > 2 * len(ERRORS)


def test_every_verb_that_writes_is_tried():
    writing = {name for name in commands() if "--out" in parser_of(name)._option_string_actions}
    assert len(writing) > 8
    assert writing - {"mean --at"} <= set(WORDS)


# A process of its own, whose files may not grow beyond some kB: as a disk that is full, with any user.
# Started with -B: Python 3.11 keeps half of a compiled module there, and every later process fails on it.
SMALL_FILES = """
import importlib, resource, sys
from rtpiv.command_line.cli import main
limit, verb = int(sys.argv[1]), sys.argv[2:]
importlib.import_module("rtpiv.verbs." + (verb[1] if verb[0] == "setup" else verb[0]))
resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
sys.exit(main(verb))
"""


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    place = tmp_path_factory.mktemp("lab")
    (place / "scene.yaml").write_text(SMALL)
    seen = np.random.default_rng(0).integers(100, 200, (96, 96)).astype(np.uint16)
    for name, shift in (("a", 0), ("b", 2)):
        tifffile.imwrite(place / f"{name}.tif", np.roll(seen, shift, axis=1))
    # Who may write nothing keeps no kernel
    words = ["trace", str(place / "scene.yaml"), "--no-pictures", "-o", str(tmp_path_factory.mktemp("compiled"))]
    assert main(words) == DONE
    return place


TRACE, CORRECT = ["trace", "scene.yaml"], ["correct", "a.tif", "--scene", "scene.yaml"]
EVALUATE = ["evaluate", "a.tif", "b.tif", "--scene", "scene.yaml"]


@pytest.mark.parametrize(
    ("words", "limit"),
    [(TRACE, 5000), slow(TRACE, 0), *(slow(words, limit) for words in (CORRECT, EVALUATE) for limit in (0, 5000))],
)
def test_a_full_disk_is_one_sentence_and_leaves_no_half_file(lab, tmp_path, words, limit):
    out = tmp_path / "out"
    if words == EVALUATE:
        frames = [str(lab / name) for name in EVALUATE[1:3]]
        given = ["--scene", str(lab / "scene.yaml"), "--no-pictures", "-o", str(tmp_path / "compiled")]
        assert main(["evaluate", *frames, *given]) == DONE
    done = subprocess.run(
        [sys.executable, "-B", "-c", SMALL_FILES, str(limit), *words, "-o", str(out)],
        cwd=lab, env=os.environ | {"PYTHONPATH": str(Path.cwd())}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == DEVICE, done.stderr
    last = done.stderr.strip().splitlines()[-1]
    assert last.startswith(f"rtpiv {words[0]}: {out}"), done.stderr
    assert "make room" in last
    assert "Traceback" not in done.stderr
    for path in out.rglob("*"):
        assert not path.name.endswith(".part"), path
        if path.suffix == ".json":
            json.loads(path.read_text())
        elif path.suffix == ".html":
            assert "</html>" in path.read_text()


# A process of its own that may not take more memory than it has, but for a little.
LITTLE_MEMORY = """
import resource, sys
from pathlib import Path
from rtpiv.command_line.cli import main
import rtpiv.verbs.trace
main(["trace", sys.argv[1], "-o", sys.argv[2] + "_small", "--no-pictures"])
used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (used + 300_000_000, used + 300_000_000))
sys.exit(main(["trace", sys.argv[3], "-o", sys.argv[2]]))
"""


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="only Linux says what a process has")
def test_what_does_not_fit_into_memory_is_refused_before_it_is_taken(lab, tmp_path):
    """A sensor of 12 000 x 12 000 px: 144 million rays."""
    (tmp_path / "large.yaml").write_text(SMALL.replace("[96, 96]", "[12000, 12000]"))
    out = tmp_path / "out"
    done = subprocess.run(
        [sys.executable, "-c", LITTLE_MEMORY, str(lab / "scene.yaml"), str(out), str(tmp_path / "large.yaml")],
        env=os.environ | {"PYTHONPATH": str(Path.cwd()), "RTPIV_THREADS": "1"},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == DEVICE, done.stderr
    said = done.stderr.strip().splitlines()
    assert "12000 x 12000 px needs about" in said[-1], done.stderr
    assert "GB are free" in said[-1]
    assert "Traceback" not in done.stderr
    assert not out.exists()


def test_memory_is_asked_for_in_all_places():
    free = free_bytes()
    require_memory(1.0, "nothing")
    if free is not None:
        assert free > 100_000_000
        with pytest.raises(MemoryShort, match=r"the world needs about .* GB of memory, and .* GB are free"):
            require_memory(2.0 * free, "the world")


@pytest.mark.posix("limits of a process")
def test_a_limit_of_the_process_counts():
    code = (
        "import resource; from ground.memory import free_bytes\n"
        "resource.setrlimit(resource.RLIMIT_AS, (3_000_000_000,) * 2)\nprint(free_bytes())"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert 0 < int(done.stdout) < 3_000_000_000
    assert resource.getrlimit(resource.RLIMIT_AS)[0] != 3_000_000_000


@pytest.mark.parametrize("sensor", ["[65535, 65535]", "[30000, 30000]"])
def test_a_sensor_that_nobody_has_is_refused_with_its_line(tmp_path, sensor, capsys):
    (tmp_path / "scene.yaml").write_text(SMALL.replace("[96, 96]", sensor))
    assert main(["trace", str(tmp_path / "scene.yaml"), "-o", str(tmp_path / "out")]) == USAGE
    assert "scene.yaml:2: camera.sensor_px: " in capsys.readouterr().err


CACHE = """
import sys
import numba
from ground.jit import compile_news
from ground.jit import kernel

@kernel
def twice(x):
    return 2.0 * x

complaints = []
compile_news.complain = complaints.append
print(twice(4.0), *complaints, sep="|")
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    "where", ["a file", *(pytest.param(where, marks=pytest.mark.slow) for where in ("/proc/none", "/dev/null"))]
)
def test_without_a_cache_kernels_are_compiled_anew_and_it_is_said(tmp_path, where):
    (tmp_path / "a file").write_text("")
    (tmp_path / "kernels.py").write_text(CACHE)
    cache = str(tmp_path / where) if where == "a file" else where
    done = subprocess.run(
        [sys.executable, str(tmp_path / "kernels.py")],
        env=os.environ | {"PYTHONPATH": str(Path.cwd()), "RTPIV_CACHE": cache, "TMPDIR": str(tmp_path)},
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    number, complaint = done.stdout.strip().split("|")
    assert number == "8.0"
    assert f"{cache}" in complaint
    assert "RTPIV_CACHE" in complaint
    assert not list(tmp_path.glob("rtpiv-kernels-*")), "the temporary one goes with the process"


READ_ONLY = """
import sys, tempfile
real = tempfile.TemporaryFile
def refused(*words, dir=None, **options):
    if str(dir).startswith(sys.argv[1]):
        raise OSError(30, "Read-only file system", str(dir))
    return real(*words, dir=dir, **options)
tempfile.TemporaryFile = refused
"""


@pytest.mark.slow
def test_a_cache_that_was_filled_and_cannot_be_written_is_read(tmp_path):
    """As in an image or on a cluster, after rtpiv setup warm."""
    said = CACHE + "print(sum(twice.stats.cache_hits.values()))\n"
    (tmp_path / "kernels.py").write_text(said)
    cache = tmp_path / "cache"

    def run(before=""):
        (tmp_path / "main.py").write_text(
            f"{before}import runpy\nrunpy.run_path({str(tmp_path / 'kernels.py')!r})\n"
        )
        done = subprocess.run(
            [sys.executable, str(tmp_path / "main.py"), str(cache)],
            env=os.environ | {"PYTHONPATH": str(Path.cwd()), "RTPIV_CACHE": str(cache), "TMPDIR": str(tmp_path)},
            capture_output=True, text=True, check=True,
        )  # fmt: skip
        return done.stdout.split()

    assert run() == ["8.0", "0"]
    kept = {path: path.stat().st_mtime_ns for path in cache.rglob("*")}
    assert run(READ_ONLY) == ["8.0", "1"]
    assert {path: path.stat().st_mtime_ns for path in cache.rglob("*")} == kept
    assert not list(tmp_path.glob("rtpiv-kernels-*"))
