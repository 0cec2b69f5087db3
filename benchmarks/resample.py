"""Resampling a frame at a smooth float map: ours against OpenCV and SciPy, interleaved in one run.

python -m benchmarks.resample [--size 2016] [--rounds 9]

Milliseconds a frame, median.  OpenCV's cubic is a 4 x 4 kernel that does not reproduce a ramp; SciPy's order 5 is
the same spline as ours, single-threaded.
"""

import argparse
import json
import time
from collections.abc import Callable

import cv2
import numpy as np
from scipy import ndimage

from correction.resample import prefilter, sample
from tracer.rows import thread_count


def measure(size: int, rounds: int) -> dict[str, float]:
    """Median time [ms] of each contender over interleaved rounds."""
    frame = np.random.default_rng(0).integers(0, 4096, (size, size)).astype(np.uint16)
    v, u = np.mgrid[:size, :size].astype(np.float64)
    position = np.stack([u + 3 * np.sin(v / 100), v + 2 * np.sin(u / 99)], -1)
    map_u, map_v = (np.ascontiguousarray(position[..., k], np.float32) for k in (0, 1))
    coefficients, values = prefilter(frame), frame.astype(np.float32)
    contenders: dict[str, Callable[[], object]] = {
        "prefilter, ours": lambda: prefilter(frame),
        "quintic, ours": lambda: sample(coefficients, position),
        "bilinear, ours": lambda: sample(frame, position, "bilinear"),
        "cubic, OpenCV": lambda: cv2.remap(values, map_u, map_v, cv2.INTER_CUBIC),
        "linear, OpenCV": lambda: cv2.remap(frame, map_u, map_v, cv2.INTER_LINEAR),
        "prefilter, SciPy order 5": lambda: ndimage.spline_filter(values, 5, output=np.float32, mode="mirror"),
        "quintic, SciPy order 5": lambda: ndimage.map_coordinates(
            coefficients, [position[..., 1], position[..., 0]], order=5, mode="mirror", prefilter=False
        ),
    }
    times: dict[str, list[float]] = {name: [] for name in contenders}
    for function in contenders.values():
        function()
    for _ in range(rounds):
        for name, function in contenders.items():
            start = time.perf_counter()
            function()
            times[name].append(1e3 * (time.perf_counter() - start))
    return {name: float(np.median(taken)) for name, taken in times.items()}


def main() -> None:
    """Measure and print one JSON document."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--size", type=int, default=2016)
    parser.add_argument("--rounds", type=int, default=9)
    options = parser.parse_args()
    cv2.setNumThreads(thread_count())
    print(json.dumps({"threads": thread_count(), "ms": measure(options.size, options.rounds)}, indent=2))


if __name__ == "__main__":
    main()
