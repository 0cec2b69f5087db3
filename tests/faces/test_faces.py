"""What the packages show at their tops: light to import, every name there, every name one that people need."""

import ast
import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path

from tests.loops import loop_over

ROOT = Path(__file__).resolve().parents[2]
FACES = ("tracer", "correction", "stages", "daq", "sim")
HEAVY = ("numpy", "numba", "scipy", "cv2", "matplotlib", "pydantic", "yaml", "rich", "tifffile", "serial")


@loop_over("name", FACES)
def test_importing_a_package_loads_nothing_heavy(name):
    code = f"import sys, {name}; print(*(m for m in sys.modules if m.partition('.')[0] in {(*FACES, *HEAVY)!r}))"
    ran = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert ran.stdout.split() == [name]


@loop_over("name", FACES)
def test_every_name_is_there_and_documented(name):
    face = import_module(name)
    assert 2 <= len(face.__all__) <= 10
    for shown in face.__all__:
        assert getattr(face, shown).__doc__, shown
        assert getattr(face, shown).__module__.partition(".")[0] == name
    assert set(face.__all__) <= set(dir(face))


def test_a_function_named_like_its_module_stays_the_function():
    code = "import tracer, tracer.strategies.ray_path, tracer.strategies.trace; print(callable(tracer.ray_path))"
    ran = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert ran.stdout.strip() == "True"


def taken_from(packages, folders):
    """Path and statement of every `from package import names` below folders; other files are not parsed."""
    begins = re.compile(rf"^[ \t]*from[ \t]+({'|'.join(packages)})[ \t]+import\b", re.MULTILINE)
    for path in (path for folder in folders for path in (ROOT / folder).rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        for node in ast.walk(ast.parse(text)) if begins.search(text) else ():
            if isinstance(node, ast.ImportFrom) and node.level == 0 and node.module in packages:
                yield path, node


def test_nothing_of_ours_takes_a_name_from_the_top_of_a_package():
    """A user's sim.py shares that top (rtpiv.neighbours): asking for a name there would run the user's file."""
    found = taken_from((*FACES, "ground"), (*FACES, "ground", "benchmarks", "rtpiv"))
    assert not [f"{path}:{node.lineno}" for path, node in found]
