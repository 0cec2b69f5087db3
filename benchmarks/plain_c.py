"""A ray map by plain C (``plain.c``), compiled when it is raced: what a day's work without a library makes."""

import ctypes
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ground.rows import run_rows
from tracer.scene.scene import Scene

OPTIONS = ("-O3", "-march=native", "-ffp-contract=fast", "-fno-math-errno", "-fno-trapping-math")


def plain_ray_map(scene: Scene) -> Callable[[], NDArray[np.float64]]:
    """Task that writes the whole map, plane points, status and branches, into arrays that exist.

    Raises
    ------
    RuntimeError
        There is no C compiler.
    """
    compiler = shutil.which("cc")
    if compiler is None:
        raise RuntimeError("there is no C compiler (cc)")
    with tempfile.TemporaryDirectory() as folder:
        made = Path(folder) / "plain.so"
        source = Path(__file__).with_name("plain.c")
        subprocess.run([compiler, *OPTIONS, "-shared", "-fPIC", source, "-o", made, "-lm"], check=True)
        trace_rows = ctypes.CDLL(str(made)).trace_rows  # without the lock of Python, as all that ctypes calls
    camera, table = scene.camera, scene.sphere_table()
    eye = np.array([*camera.position_mm, *np.ravel(camera.rotation), camera.focal_px, *camera.principal_px])
    balls = np.ascontiguousarray(table[np.argsort(-table[:, 2], kind="stable"), :5])
    height, width = camera.shape
    point, status = np.empty((height, width, 2)), np.empty((height, width), np.uint8)
    branch = np.empty((height, width), np.uint16)
    read, written = (eye, balls), (point, status, branch)

    def task() -> NDArray[np.float64]:
        known, out = ([ctypes.c_void_p(array.ctypes.data) for array in arrays] for arrays in (read, written))
        run_rows(lambda first, last: trace_rows(*known, len(balls), width, first, last, *out), height)
        return point

    return task
