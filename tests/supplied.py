"""The supplied frames and their true scenes; tests that need them skip by name where they are absent."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from piv.files.frame_file import read_frame
from tracer.bodies import Sphere
from tracer.camera import Camera, Lens, look_at, thin_lens_distance_mm
from tracer.media import ConstantMedium
from tracer.scene.scene import Scene
from tracer.scene.scene_file import load_scene

ROOT = Path(__file__).resolve().parents[1]
FRAMES = ROOT.parent / "shared" / "frames"
NOMINAL = {"one_sphere": "one_sphere_250", "two_spheres": "two_spheres_500"}
PITCH_MM = 0.011


@dataclass(frozen=True)
class Supplied:
    """One folder of supplied frames."""

    name: str
    nominal: Scene
    truth: Scene
    shift_mm: tuple[float, float]

    def frame(self, kind: str) -> NDArray[np.uint16]:
        """Read a frame, such as target_glass."""
        return read_frame(FRAMES / self.name / f"{kind}.tif", self.nominal.camera.shape)

    def path(self, kind: str) -> Path:
        """File of a frame."""
        return FRAMES / self.name / f"{kind}.tif"


def supplied(name: str) -> Supplied:
    """Frames and scenes of one_sphere or two_spheres, or skip."""
    folder = FRAMES / name
    if not folder.is_dir():
        pytest.skip(f"supplied frames {name} are not beside this checkout")
    truth = json.loads((folder / "truth.json").read_text())
    nominal = load_scene(ROOT / "examples" / f"{NOMINAL[name]}.yaml")
    x, y, dz = truth["cam"]
    position = (x, y, truth["L"] + dz)
    target = (x + truth["aim"][0], y + truth["aim"][1], 0.0)
    focal_px = thin_lens_distance_mm(truth["f"], truth["L"]) / PITCH_MM
    lens = Lens(k1=truth.get("k1", 0.0) * (focal_px / 1007.5) ** 2)
    rotation = look_at(position, target, truth["roll"])
    camera = Camera(focal_px, (1007.5, 1007.5), (2016, 2016), position, rotation, lens)
    glass = ConstantMedium(truth["n"])
    names = [sphere.name for sphere in nominal.spheres]
    bodies = [Sphere(name, tuple(c), r, glass) for name, (c, r) in zip(names, truth["spheres"], strict=True)]
    return Supplied(name, nominal, Scene(camera, tuple(bodies)), tuple(truth["shift_mm"]))
