"""10 Hz pairs (20 frames/s) to the disk, corrected as they arrive, through Harvesters or Aravis: losses, latency.

    python -m benchmarks.pipeline --seconds 60 --method bilinear -o benchmarks/results
    python -m benchmarks.pipeline --live --viewer browser   # with somebody who looks: what that costs, and whom

The simulated camera replays two rendered frames (2016 x 2016, Mono12p), so that it costs little; everything behind
its producer is what real frames pass through.  Printed and stored: the books, latency from frame complete to
corrected, disk rate, and how many cores each part has used between the first and the last frame. A viewer opens
the page when the first frame has come.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from argparse import Namespace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.options import keep, options
from benchmarks.processor_time import ProcessorTime
from daq.bench.bench_file import load_bench
from daq.bench.elements import CAMERA
from daq.errors import DaqError
from daq.live.live_page import LivePage
from daq.plans.plan import load_plan
from daq.runner.progress import Progress
from daq.runner.session import Request, Run, begin, run_session
from ground.terminal import console
from rtpiv.command_line.cli import ONE_THREAD
from rtpiv.example_files import examples
from rtpiv.verbs.acquire import run_pages
from rtpiv.verbs.operator import ScriptOperator
from sim.demo.scenes import demo_scene
from sim.renderer.patterns import print_particles
from sim.renderer.render import render
from sim.renderer.sensor import Sensor

SETTINGS = """camera:
  backend: {backend}
  settings: {{PixelFormat: Mono12p, ExposureTime: 2000.0, TriggerSelector: FrameStart, TriggerMode: "Off",
             AcquisitionFrameRate: {rate_hz}}}
  buffers: 32
  timeout_s: 5.0
"""


def write_bench(folder: Path, rate_hz: float, backend: str) -> Path:
    """The example bench with a free-running camera that replays rendered frames."""
    (folder / "ring").mkdir()
    scene = demo_scene("two_spheres_500")
    sheet = print_particles((140.0, 140.0), scene.camera.focal_px / 500.0, seed=1)
    for number, shift_mm in enumerate((0.0, 0.1)):
        image = render(scene, sheet.displace((shift_mm, shift_mm)), Sensor(), samples=1, seed=number)
        np.save(folder / "ring" / f"{number}.npy", image)
    text = (examples() / "bench-sim.yaml").read_text(encoding="utf-8")
    head, rest = text.split("camera:\n  backend", 1)
    rest = rest[rest.index("simulation:") :].replace("  seed: 7\n", "  seed: 7\n  ring: ring\n")
    (folder / "bench.yaml").write_text(
        head + SETTINGS.format(rate_hz=rate_hz, backend=backend) + rest, encoding="utf-8"
    )
    (folder / "two_spheres_500.yaml").write_bytes((examples() / "two_spheres_500.yaml").read_bytes())
    return folder / "bench.yaml"


class Viewer:
    """Somebody who opens the page; a process of its own (`benchmarks.viewer`)."""

    def __init__(self, url: str, kind: str) -> None:
        command = [sys.executable, "-m", "benchmarks.viewer", url, kind]
        self._process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, start_new_session=True)
        self.pid = self._process.pid

    def saw(self) -> dict[str, Any]:
        """What it saw, when all is over."""
        said, _ = self._process.communicate(timeout=60.0)
        return dict(json.loads(said))


def measure(folder: Path, asked: Namespace) -> dict[str, Any]:
    """Run the stream once; return books, latencies and times."""
    count = round(asked.seconds * asked.rate_hz)
    bench = load_bench(write_bench(folder, asked.rate_hz, asked.backend))
    text = f"experiment: stream\nview: glass\nframes: {count}\n"
    (folder / "plan.yaml").write_text(text)
    plan = load_plan(folder / "plan.yaml", bench)
    correction = {"correct": not asked.no_correct, "method": asked.method, "live_queue": asked.live_queue}
    request = Request(bench.path, plan.path, simulate=True, **correction)
    run = begin(request, bench, plan, folder / "runs")
    meter: list[ProcessorTime] = []
    viewers: list[Viewer] = []
    page: LivePage | None = None
    carried: dict[str, Any] = {}

    def watch(progress: Progress) -> None:
        if progress.frames >= 1 and not meter:
            if page is not None and asked.viewer != "none":
                viewers.append(Viewer(page.url, asked.viewer))
            named = {} if page is None else {"page's server": page.server_pid}
            if viewers:
                named["viewer"] = viewers[0].pid
            meter.append(ProcessorTime(named))
        if progress.doing == "exposing" and progress.frames == plan.steps[0].frames and "cores" not in carried:
            carried["cores"] = meter[0].report()

    try:
        live = Run(request, bench, plan, run)
        with run_pages(console(), live, asked.live) as pages:
            shown = pages.get(CAMERA)
            page, watching = (None, watch) if shown is None else (shown.page, shown.watching(watch))
            show = {name: each.show for name, each in pages.items()}
            run_session(live, home=True, watcher=watching, operator=ScriptOperator(), show=show)
        carried["ended"] = "finished"
    except DaqError as error:
        carried["ended"] = f"{type(error).__name__}: {error}"
    if viewers:
        carried["viewer"] = viewers[0].saw()
    entries = run.entries()
    counts = next(entry for entry in entries if entry["kind"] == "counts")
    frames = [entry for entry in entries if entry["kind"] == "frame"]
    received_ns = np.array([entry["received_ns"] for entry in frames])
    # Both clocks run on this machine: what the second lags behind the first more than at best, a frame has waited
    # in the producer, before it was counted as complete.
    unseen_ms = (received_ns - np.array([entry["timestamp_ns"] for entry in frames])) / 1e6
    unseen_ms -= unseen_ms.min()
    return {
        **carried,
        "books": counts["books"],
        "chunks": [
            {key: entry[key] for key in ("fired", "triggers", "pairs", "surplus", "lost", "dropped", "never_came")}
            for entry in entries
            if entry["kind"] == "chunk"
        ],
        "waited_unseen_ms": {"p50": round(float(np.median(unseen_ms)), 2),
                             "p99": round(float(np.percentile(unseen_ms, 99)), 2)},
        "frames_per_s": round((len(frames) - 1) / float(np.ptp(received_ns)) * 1e9, 2),
        "load_average": [round(load, 1) for load in os.getloadavg()],
        "processors": len(os.sched_getaffinity(0)),
    }  # fmt: skip


def main() -> None:
    """Measure, print, write."""
    if not ONE_THREAD.items() <= os.environ.items():  # as the command does before anything is loaded
        command = [sys.executable, "-m", "benchmarks.pipeline", *sys.argv[1:]]
        os.execve(sys.executable, command, os.environ | ONE_THREAD)
    asked = options(
        __doc__, out=Path("benchmarks/results"), seconds=60.0, rate_hz=20.0, method="quintic",
        backend="harvesters", live_queue=1, live=False, viewer="none", no_correct=False,
    )  # fmt: skip
    asked.out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=asked.out) as folder:  # the disk that is measured
        began_s = time.monotonic()
        found = measure(Path(folder), asked)
        found["wall_s"] = round(time.monotonic() - began_s, 1)
    found |= {"method": "raw only" if asked.no_correct else asked.method, "seconds": asked.seconds}
    found["backend"] = asked.backend
    keep(found, asked.out / "pipeline.json")


if __name__ == "__main__":
    main()
