"""Projection by truth.json of the supplied frames, written out here so that no tracer code is trusted."""

import json
from pathlib import Path

import numpy as np

FRAMES = Path(__file__).resolve().parents[3] / "shared" / "frames"
PITCH_MM = 0.011
CENTRE = 1007.5


def true_projection(scene, plane_z_mm=0.0):
    """Function from board points (N, 2) [mm] to acquired pixels (N, 2)."""
    truth = json.loads((FRAMES / scene / "truth.json").read_text())
    distance, focal = truth["L"], truth["f"]
    scale = 1.0 / (1.0 / focal - 1.0 / distance) / PITCH_MM
    x, y, z = truth["cam"]
    eye = np.array((x, y, distance + z))
    forward = np.array((*truth["aim"], -eye[2]))
    forward = forward / np.sqrt(forward @ forward)
    up = np.array((np.sin(truth["roll"]), np.cos(truth["roll"]), 0.0))
    up = up - forward * (up @ forward)
    up = up / np.sqrt(up @ up)
    right = np.cross(forward, up)
    k1 = truth.get("k1", 0.0)

    def project(points_mm):
        away = np.column_stack((points_mm, np.full(len(points_mm), plane_z_mm))) - eye
        depth = away @ forward
        ideal = scale * np.column_stack((away @ right / depth, -(away @ up) / depth))
        seen = ideal.copy()
        for _ in range(60):
            seen = ideal / (1.0 + k1 * (seen**2).sum(axis=1, keepdims=True) / CENTRE**2)
        return seen + CENTRE

    return project


def nominal_projection(scene):
    """What the experimenter knows: no distortion, no misalignment."""
    distance, focal = {"one_sphere": (250.0, 35.0), "two_spheres": (500.0, 60.0)}[scene]
    scale = 1.0 / (1.0 / focal - 1.0 / distance) / PITCH_MM / distance

    return lambda points_mm: CENTRE + scale * np.asarray(points_mm)[:, :2] * (1.0, -1.0)
