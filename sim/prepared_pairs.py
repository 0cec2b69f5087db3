"""Pairs that were made beforehand, so that a simulated camera can give them at the rate of a real one.

    python -m sim.prepared_pairs bench.yaml --dt-us 500 --pairs 60

writes pair_00000_a.npy, pair_00000_b.npy, ... and pairs.json into the folder that `simulation.flow.prepared`
names: the bench's true scene with every axis where the scene file holds, at its rate.  A bench replays them round
and round; pair n of a run shows pair n modulo the number of pairs.  Frames are mapped, not read: memory stays
flat.  Each is one array for good, not writeable, so that who sends it on may know it again.
"""

import argparse
import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from daq.bench.bench_file import load_bench
from sim.arranged import true_scene
from sim.bench_table import simulation_of
from sim.flow.images import FlowCamera
from tracer.errors import SceneError
from tracer.scene.scene import Scene

Frame = NDArray[np.uint16]

ABOUT = "pairs.json"
DT_TOLERANCE = 0.01  # of dt: more, and displacements would not be those of the run


class PreparedPairs:
    """A folder of prepared pairs.

    Parameters
    ----------
    folder : path
        As `prepare` left it.

    Raises
    ------
    SceneError
        The folder is not one, or was made for another scene.
    """

    def __init__(self, folder: Path | str, scene: Scene) -> None:
        self._folder = Path(folder)
        try:
            about = json.loads((self._folder / ABOUT).read_text())
            self._pairs, self._dt_s = int(about["pairs"]), float(about["dt_s"])
            made_for = str(about["scene"])
        except (OSError, ValueError, KeyError, TypeError):
            text = f"{self._folder} holds no prepared pairs; make them with python -m sim.prepared_pairs"
            raise SceneError(text) from None
        self._frames: dict[tuple[int, int], Frame] = {}
        if made_for != _content_of(scene):
            raise SceneError(f"the pairs in {self._folder} were made for another scene; make them again")

    def frame(self, number: int, pulse: int, since_first_s: float) -> Frame:
        """Frame (H, W) of pulse 0 (A) or 1 (B) of a pair, lit so long after its pulse A.

        Raises
        ------
        SceneError
            The time between the pulses is not the one that the pairs were made for.
        """
        if pulse == 1 and not abs(since_first_s - self._dt_s) <= DT_TOLERANCE * self._dt_s:
            raise SceneError(
                f"the pairs in {self._folder} were made for dt = {1e6 * self._dt_s:g} us, not "
                f"{1e6 * since_first_s:.1f} us; make them again"
            )
        key = number % self._pairs, pulse
        if key not in self._frames:
            mapped = np.load(_path(self._folder, *key), mmap_mode="r", allow_pickle=False)
            self._frames[key] = np.asarray(mapped, np.uint16)
        return self._frames[key]


def prepare(camera: FlowCamera, folder: Path, *, pairs: int, dt_s: float, rate_hz: float) -> None:
    """Make pairs and write them."""
    folder.mkdir(parents=True, exist_ok=True)
    for number in range(pairs):
        for pulse, frame in enumerate(camera.pair(number, dt_s, number / rate_hz)):
            np.save(_path(folder, number, pulse), frame)
    about = {"pairs": pairs, "dt_s": dt_s, "rate_hz": rate_hz, "scene": _content_of(camera.scene)}
    (folder / ABOUT).write_text(json.dumps(about, indent=1) + "\n")


def _content_of(scene: Scene) -> str:
    """Return what pairs depend on: the hash of the scene, and the sources of its light, which it does not hold."""
    sources = () if scene.sheet is None else scene.sheet.sources
    lit_by = f" {scene.sheet.z_mm} {scene.sheet.thickness_mm} {sources}" if scene.sheet and sources else ""
    return f"{scene.content_hash()}{lit_by}"


def _path(folder: Path, number: int, pulse: int) -> Path:
    return folder / f"pair_{number:05d}_{'ab'[pulse]}.npy"


def main() -> None:
    """Prepare the pairs of a bench."""
    parser = argparse.ArgumentParser(description="Make the pairs that a simulated bench replays.")
    parser.add_argument("bench", type=Path)
    parser.add_argument("--dt-us", type=float, required=True)
    parser.add_argument("--pairs", type=int, default=60)
    parser.add_argument("--rate-hz", type=float, default=10.0)
    asked = parser.parse_args()
    bench = load_bench(asked.bench)
    table = simulation_of(bench)
    if table.flow.prepared is None:
        raise SystemExit(f"{asked.bench}: simulation.flow.prepared does not name a folder")
    camera = table.flow.camera(true_scene(bench, table), table.seed, table.pupil)
    folder = bench.path.parent / table.flow.prepared
    prepare(camera, folder, pairs=asked.pairs, dt_s=1e-6 * asked.dt_us, rate_hz=asked.rate_hz)


if __name__ == "__main__":
    main()
