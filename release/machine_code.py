"""Compile what a first day calls, for each kind of processor that a wheel serves (`ground.jit.shipped`).

    python -m release.machine_code build/machine_code

A day's work is done on this computer first, with a cache of its own: the demo, the first hour of the README, whose
balls stand on rods, a lab of which `init` was told nothing, and the maps and a frame of every example.  What that
has left in the cache says which functions are called with which types; a process for each kind then compiles the
same for it.  It runs none of them, so this computer need not be of that kind.
"""

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

import numba
from numba.core.caching import IndexDataCacheFile

from ground.jit import Kernel
from ground.jit.kernel_cache import PACKAGES, ROOT, digest_of
from ground.jit.shipped import KINDS, MADE_BY

SIDE_PX = 256  # of the sensor that looks at the examples
FIRST_HOUR = (  # in a folder for it, with a lab beside it of which nothing was told
    "init ../plain --yes",
    "init . --yes --balls 2 --arrangement behind --glass acrylic --support-mm 8 --sensor-px 1024 1024"
    " --pixel-pitch-um 5.5",
    "check .",
    "trace scene.yaml -o trace",
    "acquire plan-target.yaml --bench bench.yaml --simulate --home",
    "calibrate runs/*plan-target -o fit",
    "acquire plan-shift.yaml --bench bench.yaml --simulate --home --scene fit/scene.yaml",
    "report runs/*plan-shift --scene fit/scene.yaml",
    "acquire plan-flow.yaml --bench bench-flow.yaml --simulate --home --operator me",
    "mean runs/*plan-flow --scene fit/scene.yaml",
    "sheet runs/*plan-flow --scene fit/scene.yaml -o sheet",
)


def main() -> None:
    """Do the day's work, then compile for all kinds at once."""
    place = Path(sys.argv[1]).resolve()  # those who work elsewhere leave it here as well
    made, here = place / f"{MADE_BY}{numba.__version__}", place / "here"
    _run("work", RTPIV_CACHE=str(here))
    compiling = []
    for kind in KINDS:
        wanted = {"RTPIV_CACHE": str(made / kind), "NUMBA_CPU_NAME": kind, "NUMBA_CPU_FEATURES": ""}
        words = [sys.executable, "-m", "release.machine_code", "compile", str(here)]
        compiling.append(subprocess.Popen(words, cwd=ROOT, env=os.environ | wanted))
    failed = [process.args for process in compiling if process.wait()]
    if failed:
        raise SystemExit("machine code could not be compiled")


def _run(*words: str, **environment: str) -> None:
    command = [sys.executable, "-m", "release.machine_code", *words]
    subprocess.run(command, cwd=ROOT, env=os.environ | environment, check=True)


def work() -> None:
    """A first day: the demo, the first hour of a new lab, and every example as somebody would look at it."""
    import numpy as np

    from correction import Corrector, build_correction_map
    from rtpiv.example_files import examples
    from rtpiv.verbs.demo import demo
    from sim.demo.scenes import at_size
    from tracer import build_ray_map, load_scene

    with tempfile.TemporaryDirectory() as place:
        demo(Path(place) / "demo")
        lab = Path(place) / "lab"
        lab.mkdir()
        for command in FIRST_HOUR:
            words = [
                str(hit) for word in command.split() for hit in (sorted(lab.glob(word)) if "*" in word else [word])
            ]
            subprocess.run([sys.executable, "-m", "rtpiv", *words], cwd=lab, check=True)
    for path in sorted(examples().glob("*.yaml")):
        if path.name.startswith(("bench", "plan")):
            continue
        scene = at_size(load_scene(path), SIDE_PX)
        corrector = Corrector(build_correction_map(scene, build_ray_map(scene)))
        corrector(np.zeros(scene.camera.shape, np.uint16))


def kernels() -> Iterator[Kernel]:
    """Every function of ours that numba compiles and keeps."""
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            if "from ground.jit import" not in path.read_text(encoding="utf-8") or path.parent.name == "jit":
                continue
            module = import_module(".".join(path.relative_to(ROOT).with_suffix("").parts))
            for each in vars(module).values():
                if isinstance(each, Kernel) and each.py_func.__module__ == module.__name__:
                    yield each


def compile_all(here: Path) -> int:
    """Compile for this process's kind of processor all that the cache in a folder holds; return how many."""
    count = 0
    for kernel in kernels():
        kept = getattr(kernel.dispatcher._cache, "_impl", None)
        if kept is None:
            continue
        digest = digest_of(Path(kernel.py_func.__code__.co_filename))
        index = IndexDataCacheFile(str(here / "rtpiv" / digest), kept.filename_base, digest)  # type: ignore[no-untyped-call]
        for signature, *_ in index._load_index():  # type: ignore[no-untyped-call]
            kernel.dispatcher.compile(signature)
            count += 1
    return count


if __name__ == "__main__":
    if sys.argv[1] == "work":
        work()
    elif sys.argv[1] == "compile":
        print(f"{os.environ['NUMBA_CPU_NAME']}: {compile_all(Path(sys.argv[2]))} functions")
    else:
        main()
