"""The paper's scenes on a small sensor for quick tests; one where nothing is aligned, and that one filled."""

from dataclasses import replace
from pathlib import Path

from tracer.bodies import Core, Sphere
from tracer.camera import look_at
from tracer.media import MEDIA, ConstantMedium
from tracer.scene.scene import Scene
from tracer.scene.scene_file import load_scene

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
SCENES = ("one_sphere_250", "two_spheres_500", "three_spheres_500", "pyramid_500", "tilted_pair", "hollow_pair")


def small_scene(name: str, size_px: int = 336) -> Scene:
    """A scene with `size_px` pixels across the same field of view."""
    if name == "hollow_pair":
        base = small_scene("tilted_pair", size_px)
        low, high = base.spheres
        thin, drop = Core(0.96 * high.radius_mm, MEDIA["air"]), Core(0.4 * low.radius_mm, ConstantMedium(1.333))
        return base.with_bodies((replace(low, cores=(drop,)), replace(high, cores=(thin,))))
    if name == "tilted_pair":
        base = small_scene("two_spheres_500", size_px)
        bodies = (
            Sphere("low", (-12.0, 8.0, 24.0), 22.0, MEDIA["N-BK7"]),
            Sphere("high", (9.0, -6.0, 72.0), 24.0, ConstantMedium(1.47)),
        )
        position = (31.0, -22.0, 480.0)
        camera = replace(base.camera, position_mm=position, rotation=look_at(position, (3.0, 2.0, 0.0), 0.2))
        return Scene(camera, bodies)
    scene = load_scene(EXAMPLES / f"{name}.yaml")
    scale = size_px / scene.camera.sensor_px[0]
    camera = replace(
        scene.camera,
        focal_px=scene.camera.focal_px * scale,
        principal_px=((size_px - 1) / 2.0, (size_px - 1) / 2.0),
        sensor_px=(size_px, size_px),
    )
    return scene.with_camera(camera)
