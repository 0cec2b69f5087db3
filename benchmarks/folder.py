"""A folder of frames corrected by one command: a frame, against reading, correcting and writing in turn.

    python -m benchmarks.folder [--frames 100] [--folder FRAMES]     # kept there, or of an earlier run

Frames are those of `benchmarks.commands`, one of them under many names, stored as a run stores them.  The time of
a frame is that of a folder less that of a single frame, over the others; what it is compared with is measured in
one process right before and after.
"""

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.commands import frames_of
from benchmarks.options import options
from correction.fitted.prepared import prepare
from correction.maps.corrector import to_uint16
from daq.runs.acquired import read_acquired
from piv.files.frame_file import write_frame
from tracer.scene.scene_file import load_scene

Seconds = tuple[float, float]  # wall clock, processors


def clocks() -> Seconds:
    """Both clocks, of this process and of its children."""
    used = os.times()
    return time.perf_counter(), used.user + used.system + used.children_user + used.children_system


def since(before: Seconds, count: int) -> Seconds:
    """Seconds a frame since then."""
    now = clocks()
    return (now[0] - before[0]) / count, (now[1] - before[1]) / count


def one_by_one(frames: list[Path], scene: Path, out: Path) -> Seconds:
    """Read, correct and write each frame, nothing at the same time."""
    loaded = load_scene(scene)
    corrector = prepare(loaded).corrector
    corrector(read_acquired(frames[0], loaded.camera.shape))
    before = clocks()
    for path in frames:
        stored, _ = to_uint16(corrector(read_acquired(path, loaded.camera.shape)))
        write_frame(out / path.name, stored, 1.0, {})
    return since(before, len(frames))


def by_command(frames: list[Path], scene: Path, out: Path) -> Seconds:
    """Let the command correct them all."""
    words = ["correct", *map(str, frames), "--scene", str(scene), "-o", str(out), "--no-pictures"]
    before = clocks()
    subprocess.run([sys.executable, "-m", "rtpiv", *words], check=True, capture_output=True)
    return since(before, 1)


def main() -> None:
    """Measure and print."""
    asked = options(__doc__, frames=100, size=2016, folder=Path)
    with frames_of(asked.size, asked.folder) as kept, tempfile.TemporaryDirectory() as place:
        scene = kept / "frames" / "truth.yaml"
        many = [Path(place) / f"frame_{number:03d}.tif" for number in range(asked.frames)]
        for path in many:
            write_frame(path, read_acquired(kept / "frames" / "particles_glass_a.tif"), 1.0, {})
        out = Path(place) / "out"
        out.mkdir()
        before = one_by_one(many[:20], scene, out)
        alone, all_of_them = by_command(many[:1], scene, out), by_command(many, scene, out)
        after = one_by_one(many[:20], scene, out)
    for clock, name in enumerate(("wall clock", "processors")):
        each = (all_of_them[clock] - alone[clock]) / (len(many) - 1)
        plain = 0.5 * (before[clock] + after[clock])
        print(f"{name}: {1e3 * each:.0f} ms a frame, one after the other {1e3 * plain:.0f} ms: {each / plain:.2f}")


if __name__ == "__main__":
    main()
