"""An edit is never missed: what a kernel is compiled from names its folder; and nothing else is compiled anew."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from ground.jit.kernel_cache import PACKAGES, ROOT, dependencies, digest_of

KERNELS = sorted(path for name in PACKAGES for path in (ROOT / name).glob("**/kernels/*.py"))
TREE = {
    "ground/jit/__init__.py": "from ground.jit.kernel_cache import cache_folder\n",
    "tracer/constants.py": "import tracer.far\nSIDE = 2.0\n",
    "tracer/far.py": "",
    "tracer/kernels/inner.py": "from tracer.constants import SIDE\n",
    "tracer/kernels/middle.py": "def f():\n    from tracer.kernels import (\n        inner,\n    )\n",
    "tracer/kernels/outer.py": "import math\n\nfrom tracer.kernels.middle import f\n",
    "tracer/kernels/world.py": "KINDS = {}\n",
    "tracer/bodies/sphere.py": "from tracer.kernels.world import KINDS\n",
    "correction/kernels/rays.py": "from tracer.kernels.world import KINDS\n",
    "correction/kernels/alone.py": "import numpy as np\n",
    "daq/light.py": "from ground.jit import kernel\nfrom tracer.kernels.inner import f\n",
    "daq/kernels/eye.py": "from daq.light import g\n",
}


@pytest.fixture
def tree(tmp_path):
    """Write a tree anew for each edit: a process reads each file once."""
    count = iter(range(1000))

    def write(**edits):
        root = tmp_path / str(next(count))
        for name, text in TREE.items():
            path = root / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text + edits.get(path.stem, ""))
        return {name: digest_of(root / name, root) for name in TREE}

    return write


@pytest.mark.parametrize(
    ("edited", "seen_by"),
    [
        ("inner", {"inner", "middle", "outer", "light", "eye"}),  # kernels, in whatever folder they stand
        ("constants", {"constants", "inner", "middle", "outer", "light", "eye"}),
        ("far", {"constants", "far"}),  # a noun's own imports compute nothing for a kernel
        ("sphere", {"sphere", "world", "rays"}),  # reached by type
        ("alone", {"alone"}),
        ("__init__", {Path(name).stem for name in TREE}),
    ],
)
def test_an_edit_is_seen_by_what_is_compiled_from_it_and_by_nothing_else(tree, edited, seen_by):
    before, after = tree(), tree(**{edited: "# edited\n"})
    changed = {Path(name).stem for name in TREE if before[name] != after[name]}
    assert changed == seen_by


def test_a_file_that_moves_is_compiled_anew(tmp_path):
    """Machine code imports the modules that it was made from by name; in another room the old name is no more."""
    for room in ("daq", "daq/acquisition"):
        place = tmp_path / room / "kernels" / "rays.py"
        place.parent.mkdir(parents=True)
        place.write_text("import numpy as np\n")
    (tmp_path / "ground/jit").mkdir(parents=True)
    (tmp_path / "ground/jit/__init__.py").touch()
    rooms = [digest_of(tmp_path / room / "kernels/rays.py", tmp_path) for room in ("daq", "daq/acquisition")]
    assert rooms[0] != rooms[1]


def test_no_ray_is_compiled_anew_for_the_piv():
    piv = set((ROOT / "piv/correlation/kernels").glob("*.py"))
    assert piv
    for path in (ROOT / "tracer").glob("kernels/*.py"):
        assert not piv & dependencies(path)


OWN_ACCOUNT = """
import importlib, json, sys, types
used = {}
for name in sys.argv[1:]:
    files = set()
    for value in vars(importlib.import_module(name)).values():
        value = getattr(value, "py_func", value)
        module = value.__name__ if isinstance(value, types.ModuleType) else getattr(value, "__module__", None)
        files.add(getattr(sys.modules.get(module or ""), "__file__", None) or "")
    used[name] = sorted(files)
print(json.dumps(used))
"""


def test_what_is_imported_is_known_whatever_way_it_is_written():
    """Python's own account of the modules' globals against the one that is read from their text."""
    modules = {".".join(path.relative_to(ROOT).with_suffix("").parts): path for path in KERNELS}
    ran = subprocess.run(
        [sys.executable, "-c", OWN_ACCOUNT, *modules], cwd=ROOT, capture_output=True, text=True, check=True
    )
    always = {ROOT / "ground/jit/__init__.py", ROOT / "ground/jit/kernel_cache.py"}
    for name, files in json.loads(ran.stdout).items():
        used = {Path(file) for file in files if file.startswith(str(ROOT / "")) and "site-packages" not in file}
        assert used <= dependencies(modules[name]) | always, name


CALLEE = "from ground.jit import kernel\n\n\n@kernel\ndef value(x: float) -> float:\n    return {} * x\n"
CALLER = (
    "from ground.jit import kernel\nfrom tracer.kernels.callee import value\n\n\n"
    "@kernel\ndef twice(x: float) -> float:\n    return 2.0 * value(x)\n"
)
USE = (
    "from tracer.kernels.caller import twice\nfrom tracer.kernels.other import other\n"
    "print(twice(1.0), other(1.0), sum(twice.stats.cache_hits.values()), sum(other.stats.cache_hits.values()))\n"
)

ALIKE = ("other_1", "other_2", "other_3")  # kernels of one text, each in a file of its own
USE_ALIKE = "".join(
    f"from tracer.kernels.{name} import other as {name}\n"
    f"print({name}(1.0), sum({name}.stats.cache_hits.values()))\n"
    for name in ALIKE
)
COUNTED = (
    "import ground.jit.compiler as compiler\nplain, read = compiler.parse_bitcode, []\n"
    "compiler.parse_bitcode = lambda bitcode: (read.append(1), plain(bitcode))[1]\n" + USE + "print(len(read))\n"
)


class Clone:
    """A checkout of some kernels."""

    def __init__(self, root):
        self.root, self.kernels = root, root / "tracer" / "kernels"

    def write(self):
        shutil.copytree(ROOT / "ground", self.root / "ground", ignore=shutil.ignore_patterns("__pycache__"))
        self.kernels.mkdir(parents=True)
        for package in (self.kernels.parent, self.kernels):
            (package / "__init__.py").touch()
        (self.kernels / "callee.py").write_text(CALLEE.format("3.0"))
        (self.kernels / "caller.py").write_text(CALLER)
        for name in ("other", *ALIKE):
            (self.kernels / f"{name}.py").write_text(CALLEE.replace("value", "other").format("7.0"))

    def use(self, cache, code=USE):
        """Call both in a process of its own: their values, and how many of each were found."""
        environment = {**os.environ, "RTPIV_CACHE": str(cache), "PYTHONPATH": str(self.root)}
        environment["PYTHONDONTWRITEBYTECODE"] = "1"  # a text as long, changed at once, keeps its own
        ran = subprocess.run(
            [sys.executable, "-c", code], cwd=self.root, env=environment, capture_output=True, text=True
        )
        assert ran.returncode == 0, ran.stderr
        return ran.stdout.split()


@pytest.fixture(scope="module")
def compiled(tmp_path_factory):
    """A clone and the cache that its first use has left."""
    folder = tmp_path_factory.mktemp("compiled")
    first = Clone(folder / "first")
    first.write()
    assert first.use(folder / "cache", USE + USE_ALIKE) == ["6.0", "7.0", "0", "0", *["7.0", "0"] * len(ALIKE)]
    return first.root, folder / "cache"


@pytest.fixture
def clone(compiled, tmp_path):
    """Another clone of the same text, and a cache that another one has filled."""
    root, cache = compiled
    shutil.copytree(cache, tmp_path / "cache")
    return Clone(shutil.copytree(root, tmp_path / "second clone")), tmp_path / "cache"


@pytest.mark.timeout(300)
def test_no_stale_callee_is_ever_run(clone):
    """The edit that numba alone misses; what does not see it comes from the cache, wherever it stands."""
    made, cache = clone
    (made.kernels / "callee.py").write_text(CALLEE.format("5.0"))
    assert made.use(cache) == ["10.0", "7.0", "0", "1"]


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_what_callers_are_compiled_from_is_read_by_who_compiles_one(clone):
    made, cache = clone
    assert made.use(cache, COUNTED) == ["6.0", "7.0", "1", "1", "0"]
    for kept in cache.rglob("caller.twice*"):
        kept.unlink()
    assert made.use(cache, COUNTED) == ["6.0", "7.0", "0", "1", "1"]


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_a_kept_file_that_cannot_be_read_is_compiled_anew_and_replaced(clone):
    """Half a file after a full disk, other people's bytes, and code that names a module which is no more."""
    made, cache = clone

    def renamed(data):
        return data.replace(b"tracer.kernels.other_3", b"tracer.kernels.forged_")

    damages = (("nbc", lambda data: data[:100]), ("nbi", lambda data: b"\0" * len(data)), ("nbc", renamed))
    kept = {}
    for name, (kind, damaged) in zip(ALIKE, damages, strict=True):
        (file,) = cache.rglob(f"{name}.other-*.{kind}")
        sound = file.read_bytes()
        kept[file] = damaged(sound)
        assert kept[file] != sound
        file.write_bytes(kept[file])
    assert made.use(cache, USE_ALIKE) == ["7.0", "0"] * 3
    assert all(file.read_bytes() != damaged for file, damaged in kept.items())
    assert made.use(cache, USE_ALIKE) == ["7.0", "1"] * 3  # each was replaced
