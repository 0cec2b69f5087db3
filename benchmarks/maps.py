"""Ray map, correction map and frame correction: ns a ray, frames a second, and ratios to plain peers."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from scipy import ndimage

from benchmarks.plain_numpy import numpy_ray_map
from benchmarks.timing import race
from correction.correction_map import build_correction_map
from correction.corrector import Corrector
from tracer.ray_map import build_ray_map
from tracer.scene_file import load_scene

SCENES = ("one_sphere_250", "two_spheres_500", "three_spheres_500", "pyramid_500")
EXAMPLES = Path(__file__).resolve().parents[1] / "examples"


def measure(rounds: int = 9) -> list[dict[str, Any]]:
    """One row a scene; every contender of a row ran interleaved in this process."""
    return [_scene(name, rounds) for name in SCENES]


def _scene(name: str, rounds: int) -> dict[str, Any]:
    scene = load_scene(EXAMPLES / f"{name}.yaml")
    ray_map = build_ray_map(scene)
    correction_map = build_correction_map(scene, ray_map)
    height, width = scene.camera.shape
    frame = np.random.default_rng(1).integers(0, 4096, (height, width)).astype(np.uint16)
    quintic, bilinear = Corrector(correction_map), Corrector(correction_map, method="bilinear")
    position = np.nan_to_num(correction_map.pixel[0], nan=-1.0)
    u, v = (np.ascontiguousarray(position[..., k], dtype=np.float32) for k in (0, 1))
    coordinates = np.moveaxis(position[..., ::-1], -1, 0)
    pixels = height * width
    maps = race(
        {
            "ours": lambda: build_ray_map(scene),
            "numpy": lambda: numpy_ray_map(scene),
            "inverse": lambda: build_correction_map(scene, ray_map),
        },
        rounds=max(3, rounds // 3),
    )
    frames = race(
        {
            "quintic": lambda: quintic(frame),
            "bilinear": lambda: bilinear(frame),
            "cv2 cubic": lambda: cv2.remap(frame, u, v, cv2.INTER_CUBIC),
            "cv2 linear": lambda: cv2.remap(frame, u, v, cv2.INTER_LINEAR),
        },
        rounds,
    )
    scipy_time = race({"scipy": lambda: ndimage.map_coordinates(frame, coordinates, np.float32, order=5)}, 1)[
        "scipy"
    ]
    return {
        "scene": name,
        "ray map ns/ray": maps["ours"].median / pixels * 1e9,
        "ray map / numpy": maps["ours"].median / maps["numpy"].median,
        "correction map / ray map": maps["inverse"].median / maps["ours"].median,
        "quintic frames/s": 1.0 / frames["quintic"].median,
        "bilinear frames/s": 1.0 / frames["bilinear"].median,
        "quintic / cv2 cubic": frames["quintic"].median / frames["cv2 cubic"].median,
        "quintic / scipy order 5": frames["quintic"].median / scipy_time.median,
        "bilinear / cv2 linear": frames["bilinear"].median / frames["cv2 linear"].median,
        "recovered share": float(correction_map.recovered.mean()),
    }
