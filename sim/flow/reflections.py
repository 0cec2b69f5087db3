"""Static light in every frame of a flow: balls that mirror the light sheet and the optics it comes from.

A ray of the camera that meets a ball is followed to its mirror direction.  By the rim, where it grazes, most of
the light is mirrored (Fresnel) and the mirror direction leads down to the sheet: a ring, smooth and brightest at
its edge.  On the flank towards the laser the ball mirrors the slit that the sheet comes from: a sharp, curved
glint. Both go with the energy of the pulse, and the two cavities' slits are not at quite the same place: A and B
have different backgrounds.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ground.rows import run_rows
from sim.flow.kernels.reflections import trace_reflections
from sim.flow.particles import LightSheet
from sim.renderer.patterns import Pose
from sim.renderer.render import tables_of
from tracer.camera import Vector3
from tracer.errors import SceneError
from tracer.scene.scene import Scene

BLUR_RAD = 0.02


@dataclass(frozen=True)
class Reflections:
    """Strength of the light in the balls.

    Parameters
    ----------
    sheet_counts : float
        Of the sheet's mirror image, where all its light is mirrored and it is looked at straight.
    glint_counts : float
        Of the laser's slit where all is mirrored.
    slit_mm : Vector3
        Middle of the slit.
    slit_half_mm : float
        Half its length, along y.
    slits_apart_mm : float
        How much higher that of pulse B is.
    haze_counts : float
        Even light everywhere: dust and droplets far from focus.
    """

    sheet_counts: float = 40.0
    glint_counts: float = 900.0
    slit_mm: Vector3 = (-400.0, 0.0, 0.0)
    slit_half_mm: float = 30.0
    slits_apart_mm: float = 6.0
    haze_counts: float = 2.0

    def __post_init__(self) -> None:
        if min(self.sheet_counts, self.glint_counts, self.haze_counts, self.slit_half_mm) < 0.0:
            raise SceneError("counts and slit_half_mm of reflections must not be negative")

    def light(self, scene: Scene, sheet: LightSheet, pulse: int) -> NDArray[np.float32]:
        """Counts (H, W) that pulse 0 (A) or 1 (B) adds to every frame."""
        world = tables_of(scene, Pose(), None, is_light=True).world
        height, width = scene.camera.shape
        out = np.empty((height, width, 2), np.float32)
        x, y, z = self.slit_mm
        source = np.array([x, y + (pulse - 0.5) * self.slits_apart_mm, z, self.slit_half_mm])

        def block(first: int, last: int) -> None:
            trace_reflections(first, last, world.camera, world.spheres, sheet.offset_mm, source, BLUR_RAD, out)

        run_rows(block, height)
        light = self.sheet_counts * out[..., 0] + self.glint_counts * out[..., 1] + np.float32(self.haze_counts)
        return np.asarray(np.float32(sheet.energies[pulse]) * light, np.float32)
