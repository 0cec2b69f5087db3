"""Contenders in turn, each in a process of its own: `python -m benchmarks.contenders NAME SCENE`.

Two pools of spinning threads in one process halve each other, so no two share one.  The process prints
``ready {"version": ...}`` or ``absent``, then answers each line ``task`` with the seconds it took, and the line
``save PATH`` by writing its ray map.  A `Racer` is the other end of it.
"""

import contextlib
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.formulas import plane_point
from benchmarks.scenes import bench_scene
from daq.child import child
from ground.rows import thread_count
from tracer.scene.scene import Scene

Tasks = dict[str, Callable[[], Any]]


def drjit(scene: Scene) -> Tasks:
    """Dr.Jit arrays on LLVM, our formulas, float64."""
    import drjit as dr
    from drjit.llvm.ad import Float64

    dr.set_thread_count(thread_count())
    height, width = scene.camera.shape

    def task() -> tuple[Any, Any]:
        index = dr.arange(Float64, height * width)
        v = dr.floor((index + 0.5) / width)
        x, y = plane_point(scene, index - v * width, v, dr.sqrt, dr.select)
        dr.eval(x, y)
        dr.sync_thread()
        return x, y

    return {"ray_map": task}


def mitsuba(scene: Scene) -> Tasks:
    """Mitsuba 3, LLVM, float32."""
    from benchmarks.renderers import mitsuba_ray_map

    return {"ray_map": mitsuba_ray_map(scene)}


def plain(scene: Scene) -> Tasks:
    """Plain C, float64, compiled here."""
    from benchmarks.plain_c import plain_ray_map

    return {"ray_map": plain_ray_map(scene)}


def filling(scene: Scene) -> Tasks:
    """Writing as many bytes as a map has, by our threads: what no tracer can go below."""
    from benchmarks.limits import fill_map

    return {"ray_map": fill_map(scene.camera.shape)}


def maps(scene: Scene) -> Tasks:
    """Ray maps of this project, into the arrays of the map before, float64 and float32, and into fresh memory."""
    from tracer.strategies.ray_map import build_ray_map

    spare, short = build_ray_map(scene), build_ray_map(scene, single=True)
    return {
        "ray_map": lambda: build_ray_map(scene, spare).plane_mm,
        "ray_map, stored as float32": lambda: build_ray_map(scene, short, single=True),
        "ray_map, fresh": lambda: build_ray_map(scene),
    }


def inverse(scene: Scene) -> Tasks:
    """Ray and correction maps with and without skips, into the arrays before; and writing those of the latter."""
    from benchmarks.limits import fill
    from correction.maps.correction_map import build_correction_map
    from ground.rows import run_rows
    from tracer.strategies.ray_map import build_ray_map

    rays, spare_rays = build_ray_map(scene), build_ray_map(scene)
    spare = build_correction_map(scene, rays)
    arrays = [value for value in vars(spare).values() if isinstance(value, np.ndarray)]
    lines = [array.reshape(-1, array.shape[-1]) for array in arrays]
    return {
        "ray map": lambda: build_ray_map(scene, spare_rays),
        **_without_mirrors(scene, (spare_rays.plane_mm, spare_rays.status, spare_rays.branch)),
        "correction map": lambda: build_correction_map(scene, rays, out=spare),
        "without skip of views that cannot win": lambda: build_correction_map(scene, rays, out=spare, skip=False),
        "writing": lambda: [run_rows(lambda a, b, x=x: fill(a, b, x), len(x)) for x in lines],  # type: ignore[misc]
    }


def frames(scene: Scene) -> Tasks:
    """A frame through one correction map by us, OpenCV and SciPy; a region is a sixteenth of the nodes.

    OpenCV's cubic is a 4 x 4 kernel that does not reproduce a ramp; SciPy's order 5 is the same spline as ours, on
    one thread.  Errors are measured in tests/piv/resampling/test_sample.py.
    """
    import cv2
    from scipy import ndimage

    from correction.maps.correction_map import build_correction_map
    from correction.maps.corrector import Corrector, to_uint16
    from piv.resampling.sample import Method, prefilter
    from tracer.strategies.ray_map import build_ray_map

    cv2.setNumThreads(thread_count())
    cmap = build_correction_map(scene, build_ray_map(scene))
    frame = np.random.default_rng(0).integers(0, 4096, scene.camera.shape).astype(np.uint16)
    rows, columns = cmap.grid.shape
    region = np.zeros((rows, columns), bool)
    region[3 * rows // 8 : 5 * rows // 8, 3 * columns // 8 : 5 * columns // 8] = True
    position = np.nan_to_num(cmap.pixel[0], nan=-1.0)
    u, v = (np.ascontiguousarray(position[..., k], np.float32) for k in (0, 1))
    coordinates = np.moveaxis(position[..., ::-1], -1, 0)
    out, coefficients = np.empty((rows, columns), np.float32), np.empty(frame.shape, np.float32)

    def ours(method: Method, mask: NDArray[np.bool_] | None) -> Callable[[], object]:
        corrector = Corrector(cmap, method=method, mask=mask)
        return lambda: corrector(frame, out)

    return {
        "quintic": ours("quintic", None),
        "bilinear": ours("bilinear", None),
        "quintic, region": ours("quintic", region),
        "bilinear, region": ours("bilinear", region),
        "prefilter alone": lambda: prefilter(frame, coefficients),
        "to uint16": lambda: to_uint16(out),
        "OpenCV cubic": lambda: cv2.remap(frame, u, v, cv2.INTER_CUBIC),
        "OpenCV linear": lambda: cv2.remap(frame, u, v, cv2.INTER_LINEAR),
        "SciPy order 5": lambda: ndimage.map_coordinates(frame, coordinates, np.float32, order=5, mode="mirror"),
    }


def _without_mirrors(scene: Scene, arrays: tuple[Any, Any, Any]) -> Tasks:
    """Ray maps traced without the mirrored half, where the strategy has one."""
    from tracer.strategies.lockstep import ALL_SKIPS, SKIP_MIRRORED, trace_lockstep
    from tracer.strategies.strategy import Kind, choose

    if choose(scene).kind is not Kind.LOCKSTEP:
        return {}
    return {"ray map, no mirrors": lambda: trace_lockstep(scene, *arrays, ALL_SKIPS & ~SKIP_MIRRORED)}


CONTENDERS: dict[str, tuple[Callable[[Scene], Tasks], str]] = {
    "rtpiv, ray maps": (maps, "numba"),
    "rtpiv, correction maps": (inverse, "numba"),
    "rtpiv, frames": (frames, "numba"),
    "filling": (filling, "numba"),
    "plain C": (plain, "numpy"),
    "drjit": (drjit, "drjit"),
    "mitsuba": (mitsuba, "mitsuba"),
}
STACKED = ("drjit",)  # their formulas know one order of spheres and no lens terms
IDEAL_LENS = ("mitsuba",)


def points(result: NDArray[np.float64] | tuple[Any, Any]) -> NDArray[np.float64]:
    """Ray map (H, W, 2) of whatever a task returned."""
    if isinstance(result, np.ndarray):
        return result
    x, y = (np.asarray(part, dtype=np.float64) for part in result)
    side = round(x.size**0.5)
    return np.stack((x.reshape(side, -1), y.reshape(side, -1)), axis=-1)


def main() -> None:
    """Answer the benchmark's lines."""
    name, scene_name = sys.argv[1:3]
    build, package = CONTENDERS[name]
    try:
        about = version(package)
        start = time.perf_counter()
        tasks = build(bench_scene(scene_name))
        for task in tasks.values():
            task()
        first_s = time.perf_counter() - start
    except (ImportError, PackageNotFoundError, RuntimeError) as error:
        print("absent", str(error).splitlines()[0], flush=True)
        return
    print("ready", json.dumps({"version": about, "tasks": list(tasks), "first_s": first_s}), flush=True)
    for line in sys.stdin:
        word, _, rest = line.strip().partition(" ")
        if word == "save":
            np.save(rest, points(tasks["ray_map"]()))
            print("saved", flush=True)
            continue
        task = tasks[line.strip()]
        start, cpu = time.perf_counter(), time.process_time()
        task()
        print(time.perf_counter() - start, time.process_time() - cpu, flush=True)


@dataclass
class Racer:
    """One contender's process and its times [s]: wall clock and processor time of each round."""

    name: str
    process: subprocess.Popen[str]
    about: dict[str, Any]
    wall: dict[str, list[float]] = field(default_factory=dict)
    cpu: dict[str, list[float]] = field(default_factory=dict)

    def ask(self, line: str) -> str:
        """Send a line, wait for the answer."""
        assert self.process.stdin
        assert self.process.stdout
        self.process.stdin.write(line + "\n")
        self.process.stdin.flush()
        return self.process.stdout.readline()

    def run(self, task: str) -> None:
        """Time one task once."""
        wall, cpu = map(float, self.ask(task).split())
        self.wall.setdefault(task, []).append(wall)
        self.cpu.setdefault(task, []).append(cpu)

    def ray_map(self) -> NDArray[np.float64]:
        """Its ray map (H, W, 2) [mm]."""
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "map.npy"
            self.ask(f"save {path}")
            return np.asarray(np.load(path))


def start(name: str, scene: str, checkout: Path | None = None) -> Racer | None:
    """Start a contender and wait until it is warm; None, and a line that says why, if it is not installed.

    It is that of another `checkout` if one is named.
    """
    command, environment = child("benchmarks.contenders", name, scene)
    if checkout is not None:
        environment["PYTHONPATH"] = os.pathsep.join((str(checkout), environment["PYTHONPATH"]))
    pipes: dict[str, Any] = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL}
    process = subprocess.Popen(command, env=environment, text=True, **pipes)
    assert process.stdout
    word, _, rest = process.stdout.readline().partition(" ")
    if word != "ready":
        process.wait()
        print(f"{name} is left out: {rest.strip() or 'it stopped'}", file=sys.stderr)
        return None
    return Racer(name, process, json.loads(rest))


def race(racers: list[Racer], rounds: int) -> None:
    """Run every task of every contender `rounds` times, in turn A B C, A B C, ..."""
    for _ in range(rounds):
        for racer in racers:
            for task in racer.about["tasks"]:
                racer.run(task)


def stop(racers: list[Racer]) -> None:
    """Let the processes end."""
    for racer in racers:
        with contextlib.suppress(BrokenPipeError):
            assert racer.process.stdin
            racer.process.stdin.close()
        racer.process.wait()


if __name__ == "__main__":
    main()
