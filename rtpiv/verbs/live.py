"""`rtpiv bench live`: show live frames, raw and corrected, in the browser; nothing is stored."""

import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from correction.maps.corrector import Corrector
from daq.bench.bench_file import load_bench
from daq.bench.bench_table import Bench
from daq.bench.opened import open_bench
from daq.cameras.frame import Frame
from daq.live.live_page import BYTES_PER_PX, LivePage
from daq.pipeline.corrections import Corrections
from daq.plans.steps import BEHIND_GLASS
from daq.runner.camera_session import CameraSession
from ground.terminal import console
from rtpiv.options.numbers import Port, Positive
from rtpiv.verbs.paths import Named
from tracer.scene.scene import Scene
from tracer.scene.scene_file import load_scene

if TYPE_CHECKING:
    from rtpiv.analysis.through_glass import ThroughGlass

BATCH = 1000  # frames of one arming


def live(
    bench: Named = "bench.yaml",
    simulate: bool = False,
    scene: Named | None = None,
    correct: bool = True,
    port: Port = 0,
    shows: Literal["chessboard", "particles", "flow"] = "chessboard",
    for_s: Positive | None = None,
    camera: str = "camera",
) -> int:
    """Show what the camera sees until Ctrl-C.

    Parameters
    ----------
    bench : path
        bench.yaml; only its camera is opened, with its settings.
    simulate : bool
        Use the simulation, with every axis at its position in the scene file.
    scene : path, optional
        Scene for the correction, such as a fitted one; default that of the bench.
    correct : bool
        Show corrected frames beside raw ones.
    port : int
        Port of the page on this computer; 0 for any free one.
    shows : {"chessboard", "particles", "flow"}
        Object in view, which selects the displayed figures.
    for_s : float, optional
        Stop after this time.
    camera : str
        Name of the camera, where the bench has several; each has a page of its own, in a terminal of its own.

    Returns
    -------
    int
        Frames seen.

    Raises
    ------
    PlanError
        The bench has no such camera.
    CameraError
        The camera is not there, or gives no frame.
    PageError
        The page cannot be shown.
    """
    screen, loaded = console(), load_bench(bench).as_seen_by(camera)
    height, width = loaded.scene.camera.shape
    believed = loaded.scene if scene is None else load_scene(Path(scene))
    with ExitStack() as stack:
        page = stack.enter_context(LivePage(BYTES_PER_PX * height * width, port, believed, loaded.board))
        screen.print(f"look at {page.url}", soft_wrap=True, highlight=False)
        screen.print("from elsewhere: ssh -L the port to this computer; Ctrl-C ends it")
        page.say("making the correction; the first one on a computer compiles for about a minute")
        corrector = _corrector(believed) if correct else None
        shown = None if corrector is None else _through(believed, corrector)
        page.say("opening the camera")
        opened = stack.enter_context(open_bench(load_bench(bench), simulate, shows, only={camera}))
        hardware = opened.as_seen_by(camera)
        exposures = CameraSession(hardware.camera, hardware.camera_section, rendering_s=hardware.rendering_s)
        exposures.set_up()
        if hardware.simulation is not None:  # its axes begin where they were switched off; no stage is opened
            hardware.simulation.place(loaded.home_mm)
        page.say("waiting for the camera's first frame")
        seen, begun_s = 0, time.monotonic()
        try:
            for frame in _endless(exposures):
                with frame:
                    corrected = None if corrector is None else corrector(frame.pixels)
                    words, pictures = _snapshot(loaded, frame, corrected, shows, seen, begun_s)
                    if shown is not None:
                        words["run"] += f"; {shown.sentence}"
                    page.say(words["doing"])
                    page.show(words, pictures)
                seen += 1
                if for_s is not None and time.monotonic() - begun_s > for_s:
                    break
        except KeyboardInterrupt:
            pass
        finally:
            exposures.end()
    return seen


def _through(scene: Scene, corrector: Corrector) -> "ThroughGlass | None":
    from rtpiv.analysis.through_glass import through_glass  # compiled: who asks for help does not wait

    return through_glass(scene, corrector.map.grid, corrector.recovered)


def _corrector(scene: Scene) -> Corrector:
    corrections = Corrections(scene)
    corrections.prepare([BEHIND_GLASS])
    return corrections.corrector(BEHIND_GLASS)


def _endless(exposures: CameraSession) -> Iterator[Frame]:
    while True:
        for _, frame in exposures.frames(BATCH, may_lose=BATCH):
            yield frame


def _snapshot(
    bench: Bench,
    frame: Frame,
    corrected: NDArray[np.float32] | None,
    shows: str,
    seen: int,
    begun_s: float,
) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    elapsed_s = max(time.monotonic() - begun_s, 1e-9)
    age_ms = (time.monotonic_ns() - frame.meta.received_ns) / 1e6
    words = {
        "run": f"{bench.table.name}: nothing is kept",
        "doing": "the correction is for axes at the place in the scene file",
        "shows": shows,
        "view": BEHIND_GLASS,
        "rims": True,
        "bits": frame.meta.significant_bits,
        "counters": {
            "frames": [str(seen + 1), False],
            "frames a second": [f"{(seen + 1) / elapsed_s:.1f}", False],
            "from camera to page": [f"{age_ms:.0f} ms", age_ms > 500.0],
        },
    }
    pictures: dict[str, NDArray[Any]] = {"raw": frame.pixels}
    if corrected is not None:
        pictures["corrected"] = corrected
    return words, pictures
