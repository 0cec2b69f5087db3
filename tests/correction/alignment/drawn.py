"""Frames of a board and of balls before it, drawn without rays: a ball is a dark ring around a grey disc.

What is drawn is where the pinhole says it is, by other arithmetic than that of the package: a line of sight
belongs to a ball if it passes within the radius.
"""

from dataclasses import replace

import numpy as np
import scipy

from correction.target import Chessboard
from sim.demo.scenes import at_size, demo_scene
from tracer.bodies import translate_by

BOARD = Chessboard()
RING = 0.96  # of the radius, within which a ball is grey: nearer to the rim rays graze the glass


def scene_of(name="pair", size_px=800):
    """A scene that shows both rims whole, one of them before the other ball; or one by its name."""
    if name != "pair":
        return at_size(demo_scene(name), size_px)
    scene = at_size(demo_scene("two_spheres_500"), size_px)
    near, far = scene.spheres
    return scene.with_bodies(
        [
            replace(near, name="near", centre_mm=(-14.0, -6.0, 26.0)),
            replace(far, name="far", centre_mm=(18.0, 10.0, 70.0)),
        ]
    )


def moved(scene, *, glass_mm=(0.0, 0.0, 0.0), camera_mm=(0.0, 0.0, 0.0)):
    """The scene with glass and camera elsewhere."""
    x, y, z = np.add(scene.camera.position_mm, camera_mm).tolist()
    bodies = tuple(body.moved(translate_by(np.array(glass_mm))) for body in scene.bodies)
    return replace(scene, camera=replace(scene.camera, position_mm=(x, y, z)), bodies=bodies)


def drawn(scene, *, blur_px=2.0, uneven=0.03, noise=20.0, seed=0, board=BOARD, lower_mm=0.0):
    """A frame (H, W) uint16 of a scene; balls stand `lower_mm` lower than there, where no scene may have them."""
    camera = scene.camera
    height, width = camera.shape
    eye = np.array(camera.position_mm)
    v, u = np.mgrid[0:height, 0:width]
    rng = np.random.default_rng(seed)
    within = rng.uniform(
        -0.5, 0.5, (height, width, 2)
    )  # a sample a pixel, anywhere in it: the blur makes a mean of them
    ray = camera.directions(np.stack((u, v), axis=-1) + within)
    plane = eye - ray * (eye[2] / ray[..., 2:])
    value = 0.1 + 0.8 * board.shade(plane[..., :2]) if board else np.full(camera.shape, 0.7)
    for ball in sorted(scene.spheres, key=lambda one: one.centre_mm[2]):  # the nearest last
        away = np.array(ball.centre_mm) - eye - (0.0, 0.0, lower_mm)
        along = ray @ away
        beside = np.sqrt(away @ away - along**2) / ball.radius_mm
        value = np.where(beside < RING, 0.3, np.where(beside < 1.0, 0.03, value))
    light = scipy.ndimage.gaussian_filter(value, blur_px)
    light *= 1.0 + uneven * np.linspace(-1.0, 1.0, width)
    return np.clip(3000.0 * light + rng.normal(0.0, noise, light.shape), 0, 4095).astype(np.uint16)


def ring(frame, u, v, radius_px, value=0.0, width_px=3.0):
    """The frame with a ring on it, such as that of a bubble or of dust."""
    row, col = np.indices(frame.shape)
    on = np.abs(np.hypot(col - u, row - v) - radius_px) < 0.5 * width_px
    return np.where(on, np.uint16(4095 * value), frame)
