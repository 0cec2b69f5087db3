"""The first run after an install, which compiles its kernels, gives the bits of all later ones, which load them.

A kernel that is compiled both by itself and into a caller exists twice; a process that compiles uses the one, a
process that loads the other.  They must round alike (``ground.jit``).
"""

import hashlib
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from llvmlite.binding import get_host_cpu_features

from correction.fit.seen.prediction import expect, measure
from correction.maps.correction_map import build_correction_map
from correction.maps.corrector import Corrector
from correction.target import Chessboard
from ground.jit.shipped import KINDS
from piv.correlation.pair import evaluate_pair
from rtpiv.command_line.first_use import calls_of, compile_call
from sim.demo.scenes import at_size, demo_scene
from sim.renderer.patterns import Chessboard as Print
from sim.renderer.render import render
from sim.renderer.sensor import Sensor
from tracer.strategies.ray_map import build_ray_map
from tracer.strategies.sensitivity import TargetPose, landings
from tracer.strategies.trace import trace

ROOT = Path(__file__).resolve().parents[2]
SCENES = ("one_sphere_250", "two_spheres_500", "pyramid_500", "tilted")


def fingerprint() -> str:
    """Digests of what every kernel of a scene's way gives, one scene a line."""
    rng, lines = np.random.default_rng(1), []
    for name in SCENES:
        scene = at_size(demo_scene(name), 400)
        ray_map = build_ray_map(scene)
        corrected = build_correction_map(scene, ray_map, layers=2)
        pixels = rng.uniform(0.0, 399.0, (2000, 2))
        pair = rng.integers(0, 4096, (2, *scene.camera.shape)).astype(np.uint16)
        quintic, bilinear = Corrector(corrected), Corrector(corrected, method="bilinear")
        field = evaluate_pair(quintic(pair[0]), quintic(pair[0]), quintic.recovered)
        board = Chessboard(5.0, 2.0)
        corners = measure(
            render(scene, Print(5.0, 2.0), Sensor(), seed=1), expect(scene, TargetPose(), board), board
        )
        made = {
            "ray map": (ray_map.plane_mm, ray_map.status, ray_map.branch),
            "correction map": tuple(corrected.arrays().values()),
            "frames": (quintic(pair[0]), bilinear(pair[1])),
            "rays": (trace(scene, pixels).rays,),
            "derivatives": (landings(scene, pixels).rate,),
            "vectors": (field.u_px, field.v_px, field.sigma_u_px),
            "corners": (corners.position_px, corners.covariance_px2),
        }
        digests = [
            f"{key} {hashlib.sha256(b''.join(a.tobytes() for a in arrays)).hexdigest()[:12]}"
            for key, arrays in made.items()
        ]
        lines.append(f"{name}: {', '.join(digests)}")
    return "\n".join(lines)


def compile_rays() -> None:
    """Compile what traces scenes of few balls, of opaque ones and of many, and what turns their maps round."""
    pixels = np.random.default_rng(1).uniform(0.0, 399.0, (2000, 2))
    for name in SCENES:
        scene = at_size(demo_scene(name), 400)
        build_correction_map(scene, build_ray_map(scene), layers=2)
        trace(scene, pixels)
        landings(scene, pixels)
    blocked = at_size(demo_scene(SCENES[0]), 64)
    blocked = blocked.with_bodies([replace(blocked.bodies[0], medium=None)])
    build_correction_map(blocked, build_ray_map(blocked))


def compile_frames() -> None:
    """Compile what takes frames: it shares next to nothing with `compile_rays`, and goes beside it."""
    for call in calls_of("warm"):
        if not call[0].startswith(("tracer.", "correction.inversion.")):
            compile_call(call)
    frames = np.random.default_rng(1).integers(0, 4096, (2, 400, 400)).astype(np.float32)
    evaluate_pair(frames[0], frames[1], np.ones(frames[0].shape, bool))
    render(at_size(demo_scene(SCENES[0]), 64), Print(5.0, 2.0), Sensor(), seed=1)


def printed(cache: Path, **wanted: str) -> str:
    """Fingerprint of a process with a cache of its own."""
    environment = {**os.environ, "RTPIV_CACHE": str(cache), "PYTHONPATH": str(ROOT), **wanted}
    code = "from tests.system.test_cold_start import fingerprint; print(fingerprint())"
    ran = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, env=environment, capture_output=True, text=True, check=True
    )
    assert ran.stdout.count(":") == len(SCENES)
    return ran.stdout


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_compiling_and_loading_give_the_same_bits(tmp_path):
    assert printed(tmp_path) == printed(tmp_path)


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("kind", KINDS)
def test_code_for_a_kind_of_processor_gives_the_bits_of_code_for_this_one(tmp_path, kind):
    """What a wheel carries, and what a computer compiles for itself."""
    if not all(map(get_host_cpu_features().get, KINDS[kind])):
        pytest.skip(f"this processor is no {kind}")
    of_kind = printed(tmp_path / kind, NUMBA_CPU_NAME=kind, NUMBA_CPU_FEATURES="")
    assert of_kind == printed(tmp_path / "here")
