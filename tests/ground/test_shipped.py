"""Machine code that comes with a wheel is used where it fits, and never stands in the way."""

import os
import platform
import shutil
import subprocess
import sys

import llvmlite.binding
import numba
import pytest

from ground.jit.kernel_cache import ROOT
from ground.jit.shipped import KINDS, other_numba, wheel_folder
from tests.ground.test_kernel_cache import CALLEE, CALLER, USE

KIND = "x86-64-v3"
HERE = "import ground.jit.compiler as compiler\ncompiler.use_shipped = False\n"
pytestmark = [
    pytest.mark.timeout(300),
    pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="code is shipped for x86-64 alone"),
]


class Install:
    """An installed wheel with two kernels, and a user without compiled code."""

    def __init__(self, root):
        self.root, self.made = root, root / "ground/jit/machine_code" / f"numba-{numba.__version__}" / KIND
        (root / "tracer" / "kernels").mkdir(parents=True)
        for package in (root / "tracer", root / "tracer" / "kernels"):
            (package / "__init__.py").touch()
        shutil.copytree(
            ROOT / "ground", root / "ground", ignore=shutil.ignore_patterns("__pycache__", "machine_code")
        )
        (root / "tracer/kernels/callee.py").write_text(CALLEE.format("3.0"))
        (root / "tracer/kernels/caller.py").write_text(CALLER)
        (root / "tracer/kernels/other.py").write_text(CALLEE.replace("value", "other").format("7.0"))
        self._count = iter(range(100))

    def use(self, before="", **wanted):
        """Call both with an empty cache: their values, and how many of each were found."""
        wanted = {
            "RTPIV_CACHE": str(self.root / f"cache{next(self._count)}"),
            "PYTHONPATH": str(self.root),
        } | wanted
        ran = subprocess.run(
            [sys.executable, "-c", before + USE], cwd=self.root, env={**os.environ, **wanted},
            capture_output=True, text=True,
        )  # fmt: skip
        assert ran.returncode == 0, ran.stderr
        return ran.stdout.split()


@pytest.fixture(scope="module")
def install(tmp_path_factory):
    made = Install(tmp_path_factory.mktemp("wheel") / "site")
    cache = made.root / "made"
    assert made.use(RTPIV_CACHE=str(cache), NUMBA_CPU_NAME=KIND, NUMBA_CPU_FEATURES="") == ["6.0", "7.0", "0", "0"]
    shutil.copytree(cache / "rtpiv", made.made)
    return made


@pytest.fixture
def able():
    has = llvmlite.binding.get_host_cpu_features()
    if not all(map(has.get, KINDS[KIND])):
        pytest.skip(f"this processor is no {KIND}")


@pytest.mark.slow
def test_what_came_with_the_wheel_is_not_compiled(install, able):
    assert install.use() == ["6.0", "7.0", "1", "1"]


@pytest.mark.slow
def test_a_computer_may_compile_for_itself(install, able):
    assert install.use(HERE) == ["6.0", "7.0", "0", "0"]


@pytest.mark.slow
def test_what_is_damaged_or_of_an_edited_file_is_compiled(install, able):
    """One kernel's code is cut short, what another one calls is edited; see above for both as they came."""
    (kept,) = install.made.rglob("other.other*.nbc")
    sound = kept.read_bytes()
    kept.write_bytes(sound[:100])
    callee = install.root / "tracer/kernels/callee.py"
    callee.write_text(CALLEE.format("5.0"))
    assert install.use() == ["10.0", "7.0", "0", "0"]
    kept.write_bytes(sound)
    callee.write_text(CALLEE.format("3.0"))


@pytest.mark.slow
def test_another_numba_compiles_and_is_named(install, tmp_path):
    made_by = f"numba-{numba.__version__}"
    shutil.copytree(install.made, tmp_path / "numba-0.1.0" / KIND)
    assert wheel_folder(numba.__version__, tmp_path) is None
    assert other_numba(numba.__version__, tmp_path) == "0.1.0"
    (tmp_path / made_by).mkdir()
    assert other_numba(numba.__version__, tmp_path) is None
    assert other_numba(numba.__version__, tmp_path / "no such") is None


@pytest.mark.parametrize(("lacks", "taken"), [
    ((), "x86-64-v4"), (("avx512vl",), "x86-64-v3"), (("avx512f", "fma"), None), (KINDS["x86-64-v4"], None),
])  # fmt: skip
def test_a_processor_takes_the_best_that_it_can_run(tmp_path, mocker, lacks, taken):
    for kind in KINDS:
        (tmp_path / "numba-1.0" / kind).mkdir(parents=True)
    has = {name: name not in lacks for name in KINDS["x86-64-v4"]}
    mocker.patch("llvmlite.binding.get_host_cpu_features", return_value=has)
    found = wheel_folder("1.0", tmp_path)
    assert (found and found.name) == taken


def test_a_kind_that_the_wheel_lacks_is_left_out(tmp_path, mocker):
    (tmp_path / "numba-1.0" / KIND).mkdir(parents=True)
    mocker.patch("llvmlite.binding.get_host_cpu_features", return_value=dict.fromkeys(KINDS["x86-64-v4"], True))
    found = wheel_folder("1.0", tmp_path)
    assert found is not None
    assert found.name == KIND
