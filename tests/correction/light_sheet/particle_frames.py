"""Frames of particles in a light sheet behind glass, by the simulator's own optics."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from sim.demo.scenes import at_size, demo_scene
from sim.flow.fields import Flow
from sim.flow.images import FlowCamera
from sim.flow.jet import Jet
from sim.flow.particles import LightSheet, Seeding
from sim.renderer.render import Aperture
from tracer.bodies import translate_by

GAP_MM, DT_S = 4.0, 500e-6


def camera(
    name,
    size_px,
    z_mm=0.0,
    tilts_deg=(0.0, 0.0),
    thickness_mm=1.0,
    per_px=0.03,
    f_number=None,
    seed=14,
    modes=None,
    crop_px=None,
):
    """A camera that sees a jet behind balls `GAP_MM` off the target's plane, or only the middle of its view."""
    stack = at_size(demo_scene(name), size_px)
    if crop_px is not None:
        middle = np.subtract(stack.camera.principal_px, 0.5 * (size_px - crop_px))
        lens = replace(stack.camera, principal_px=tuple(middle.tolist()), sensor_px=(crop_px, crop_px))
        stack = stack.with_camera(lens)
    scene = stack.with_bodies([body.moved(translate_by((0.0, 0.0, GAP_MM))) for body in stack.bodies])
    sheet = LightSheet(thickness_mm, z_mm, *np.tan(np.deg2rad(tilts_deg)))
    lens = {}
    if f_number is not None:  # pictures wider than a particle need more points than the middle and a ring
        points = 7 if f_number > 12.0 else 19
        lens |= {"aperture": Aperture(60.0, f_number, 440.0), "particle_counts": 300.0, "points_of_pupil": points}
    return FlowCamera(scene, Flow(Jet(), modes), sheet=sheet, seeding=Seeding(per_px), seed=seed, **lens)


def frames_of(flow_camera, pairs):
    """Pairs of frames as `find_sheet` asks for them; drawn once."""
    drawn = [
        tuple(np.asarray(frame, np.float32) for frame in flow_camera.pair(number, DT_S, 0.1 * number))
        for number in range(pairs)
    ]

    def given() -> Iterator:
        return iter(drawn)

    return given


def moved(scene, number, step_mm):
    """The scene with one body elsewhere."""
    bodies = list(scene.bodies)
    bodies[number] = replace(bodies[number], centre_mm=tuple(np.add(bodies[number].centre_mm, step_mm)))
    return scene.with_bodies(bodies)
