"""Frame sets of a scene with hidden misalignment: what an experimenter would have on disk, and the truth.

A folder holds

    scene.yaml                     the nominal scene: all that the correction may read
    truth.yaml                     the true scene, for scoring only
    frames.json                    board, stage positions, particle shift, sensor, seed
    target_clear.tif, target_glass.tif, target_clear_z+10mm.tif ...
    particles_clear_a.tif, particles_clear_b.tif, particles_glass_a.tif, particles_glass_b.tif

The chessboard fills the frame with an inner corner at the world's origin; z-stacks show it moved by its
stage.  The particle sheet moves 14 px to the north-east between a and b.
"""

import io
import json
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import tifffile
from numpy.typing import NDArray

from ground.whole_file import whole_file
from sim.demo.scenes import BARREL_35MM, at_size, demo_scene, misalign
from sim.renderer.patterns import Chessboard, ParticleSheet, Pattern, Pose, place, print_particles
from sim.renderer.render import render
from sim.renderer.sensor import Sensor
from tracer.scene.scene import Scene
from tracer.scene.scene_file import dump_scene, load_scene

SHIFT_PX = 14.0
CLEAR_STACK_MM = (-20.0, -10.0, 10.0, 20.0)
GLASS_STACK_MM = (-20.0, -10.0)


@dataclass(frozen=True)
class FrameSet:
    """A folder of frames with its truth.

    Parameters
    ----------
    folder : Path
        Where the files lie.
    nominal, truth : Scene
        What the experimenter believes, and what the camera saw.
    square_mm : float
        Edge of the chessboard's squares.
    shift_mm : (float, float)
        True shift of the particle sheet from a to b.
    """

    folder: Path
    nominal: Scene
    truth: Scene
    square_mm: float
    shift_mm: tuple[float, float]

    def path(self, kind: str) -> Path:
        """File of a frame, such as ``target_glass`` or ``target_clear_z+10mm``."""
        return self.folder / f"{kind}.tif"

    def frame(self, kind: str) -> NDArray[np.uint16]:
        """Read one frame (H, W)."""
        return np.asarray(tifffile.imread(self.path(kind)))

    @property
    def kinds(self) -> list[str]:
        """Names of the frames there are."""
        return sorted(path.stem for path in self.folder.glob("*.tif"))


def make_frames(
    name_or_scene: str | Scene,
    size_px: int,
    seed: int,
    folder: Path | str,
    *,
    sensor: Sensor | None = None,
    samples: int = 4,
    stack: bool = True,
) -> FrameSet:
    """Render the frame set of a scene.

    Parameters
    ----------
    name_or_scene : str or Scene
        Name of a demo scene (`sim.demo.scenes.SCENES`) or a nominal scene.
    size_px : int
        Pixels across the sensor; the field of view stays.
    seed : int
        Of the misalignment, the particles and the noise.
    folder : path
        Created if need be; files of the same name are replaced, each at once.
    sensor : Sensor, optional
        Default: the sensor of the paper, 12 bit.
    samples : int
        Rays across a pixel.
    stack : bool
        Whether to render the z-stack.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    nominal = demo_scene(name_or_scene) if isinstance(name_or_scene, str) else name_or_scene
    barrel = BARREL_35MM if name_or_scene == "one_sphere_250" else 0.0
    nominal = at_size(nominal, size_px)
    truth = misalign(nominal, seed, barrel=barrel)
    board, sheet, shift = _prints(nominal, seed)
    shots = _shots(truth, board, sheet, shift, stack)
    for number, (kind, (scene, pattern)) in enumerate(shots.items()):
        image = render(scene, pattern, sensor or Sensor(), samples=samples, seed=1000 * seed + number)
        _write_tiff(folder / f"{kind}.tif", image)
    _write_text(folder / "scene.yaml", dump_scene(nominal))
    _write_text(folder / "truth.yaml", dump_scene(truth))
    facts = {"square_mm": board.square_mm, "shift_mm": shift, "seed": seed, "sensor": asdict(sensor or Sensor())}
    _write_text(folder / "frames.json", json.dumps(facts, indent=1))
    return load_frames(folder)


def load_frames(folder: Path | str) -> FrameSet:
    """Read the scenes and facts of a folder that `make_frames` wrote."""
    folder = Path(folder)
    facts = json.loads((folder / "frames.json").read_text(encoding="utf-8"))
    x_mm, y_mm = facts["shift_mm"]
    nominal, truth = load_scene(folder / "scene.yaml"), load_scene(folder / "truth.yaml")
    return FrameSet(folder, nominal, truth, float(facts["square_mm"]), (float(x_mm), float(y_mm)))


def _prints(nominal: Scene, seed: int) -> tuple[Chessboard, ParticleSheet, tuple[float, float]]:
    """Board, particle sheet and its shift, at the scale of the nominal camera."""
    camera = nominal.camera
    px_per_mm = camera.focal_px / float(np.linalg.norm(camera.position_mm))
    # Glass looks past the edge of the bare view: print half as much again.
    width, height = (1.5 * size / px_per_mm for size in camera.sensor_px)
    sheet = print_particles((width, height), px_per_mm, seed=seed)
    step = SHIFT_PX / px_per_mm / np.sqrt(2.0)
    return Chessboard(), sheet, (float(step), float(step))


def _shots(
    truth: Scene, board: Chessboard, sheet: ParticleSheet, shift_mm: tuple[float, float], stack: bool
) -> dict[str, tuple[Scene, Pattern]]:
    """Name of each frame -> what stands before the camera and what hangs behind it."""
    clear = truth.bare()
    moved = sheet.displace(shift_mm)
    shots: dict[str, tuple[Scene, Pattern]] = {}
    for view, scene, heights in (("clear", clear, CLEAR_STACK_MM), ("glass", truth, GLASS_STACK_MM)):
        shots[f"target_{view}"] = scene, board
        for z in heights if stack else ():
            shots[f"target_{view}_z{z:+.0f}mm"] = scene, place(board, Pose((0.0, 0.0, z)))
        shots[f"particles_{view}_a"] = scene, sheet
        shots[f"particles_{view}_b"] = scene, moved
    return shots


def _write_tiff(path: Path, image: NDArray[np.uint16]) -> None:
    buffer = io.BytesIO()
    tifffile.imwrite(buffer, image, photometric="minisblack", compression="zlib")
    _write_bytes(path, buffer.getvalue())


def _write_text(path: Path, text: str) -> None:
    _write_bytes(path, text.encode())


def _write_bytes(path: Path, content: bytes) -> None:
    with whole_file(path) as stream:
        stream.write(content)
