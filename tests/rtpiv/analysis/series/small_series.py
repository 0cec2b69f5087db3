"""A flow run as small as it can be: a bare camera over moving particles, with reflections that stand still."""

import json
from pathlib import Path

import numpy as np

from daq.runs.journal import Journal
from daq.runs.pairs import pairs_of
from daq.runs.run_folder import RunFolder
from piv.correlation.settings import PivSettings
from piv.preprocessing.preparation import Preparation
from rtpiv.analysis.series.series_input import SeriesInput
from rtpiv.analysis.series.series_pairs import pairs_of_series
from rtpiv.analysis.series.series_plan import Method
from tests.daq.small_run import about_run, keep_frame, planned
from tests.piv.conftest import draw
from tracer.scene.scene_file import load_scene

SIDE_PX = 96
SCENE = (
    f"camera: {{focal_px: 400.0, sensor_px: [{SIDE_PX}, {SIDE_PX}], position_mm: [0.0, 0.0, 500.0]}}\nbodies: []\n"
)
DT_US = 50.0
PX_PER_MM = 0.8
SETTINGS = PivSettings(windows_px=(32, 16), extra_passes=0)


def frames_of(rng, shift_px, side=SIDE_PX, particles=250):
    """Frames A and B (uint16): particles that moved by `shift_px` (right, down), a static reflection, noise."""
    places = rng.uniform(-10, side + 10, (particles, 2))
    light = rng.uniform(300.0, 900.0, particles)
    reflection = np.zeros((side, side))
    reflection[side // 3 : side // 2, side // 4 : side // 2] = 1200.0
    pair = []
    for way in (-0.5, 0.5):
        u, v = (places + way * np.asarray(shift_px)).T
        image = draw((side, side), u, v, 2.6, light) + reflection + rng.normal(40.0, 4.0, (side, side))
        pair.append(np.clip(np.rint(image), 0, 4095).astype(np.uint16))
    return pair


def flow_run(
    parent, pairs, shift=lambda n: (2.0, -1.0), side=SIDE_PX, unseeded=0, spoiled=None, stream=False, **changed
):
    """A flow run on the disk: `unseeded` background pairs, then `pairs`; returns its folder.

    A `stream` has the same frames, and nobody says which light pulse they are of.

    `spoiled` maps the number of a pair to a function of its two frames; `changed` replaces facts of frames.
    """
    steps, first = [], 0
    for tag, count, background in (("dark", unseeded, True), ("flow", pairs, False)):
        if count:
            step = planned(len(steps), tag, frames=2 * count, first_frame=first)
            step |= (
                {"group": 2} | ({} if stream else {"dt_us": DT_US}) | ({"background": True} if background else {})
            )
            steps.append(step)
            first += 2 * count
    folder = RunFolder.create(parent, "flow", about_run(steps) | {"scene": SCENE})
    journal = Journal(folder.journal_path)
    rng = np.random.default_rng(5)
    for step in steps:
        for place in range(step["frames"] // 2):
            is_dark = step.get("background", False)
            both = frames_of(rng, shift(place), side, particles=0 if is_dark else 250)
            if spoiled and not is_dark and place in spoiled:
                both = spoiled[place](*both)
            for pulse, pixels in enumerate(both):
                number = step["first_frame"] + 2 * place + pulse
                record = {"exposure": "AB"[pulse], "chunk": 0, "dt_us": DT_US, "marker": "halves"}
                record |= {"background": True} if is_dark else {}
                facts = {"step": step["index"], "tag": step["tag"], "sequence": number}
                facts |= {} if stream else {"pair": record}
                facts["timestamp_ns"] = 10**9 + 100_000_000 * (number // 2) + 50_000 * pulse
                facts["received_ns"] = facts["timestamp_ns"] + 1000
                facts |= {name: value(number) for name, value in changed.items()}
                keep_frame(folder, journal, number, pixels, **facts)
    journal.close()
    return folder.path


def given_of(run, dt_us=None, timed=True):
    """Pairs of a run as a series."""
    return pairs_of_series(run, pairs_of(run), dt_us, timed)


def method_of(folder, *steps, settings=SETTINGS):
    """How small runs are evaluated."""
    (folder / "scene.yaml").write_text(SCENE)
    return Method(load_scene(folder / "scene.yaml"), None, settings, Preparation(steps))


def content_of(out):
    """Bytes of every file of a series that must not differ, by name."""
    files = [*sorted((out / "chunks").iterdir()), out / "series.json"]
    return {str(file.relative_to(out)): file.read_bytes() for file in files}


def markers(out):
    """Markers by number of their chunk."""
    return {int(file.stem): json.loads(file.read_bytes()) for file in (out / "chunks").glob("*.json")}


def series_of(out, given, method, name="flow"):
    """A series of a run that is called so, into a folder."""
    return SeriesInput(Path(name), out, given, method)
