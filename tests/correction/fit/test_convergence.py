"""From random starts to the true scene, or to a refusal, or to a ball masked by name; never wrong in silence."""

import os
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from correction.errors import FitError
from correction.fit.scene_fit import fit_scene
from correction.fit.solve.contact import push_apart
from tests.correction.fit.benches import bench
from tracer.media import ConstantMedium
from tracer.scene.scene import Scene

STARTS = int(os.environ.get("STARTS", "10"))  # of the 200 that docs/adr/0005 reports; 2 to 10 s of a core each
SCENES = [("one_sphere_250", 7), ("two_spheres_500", 6), ("three_spheres_500", 3), ("pyramid_500", 5)]


def disturbed(truth: Scene, nominal: Scene, rng: np.random.Generator) -> Scene:
    """Every centre off by up to 1 mm an axis, n by 0.01, the camera by 1 mm and 0.5 deg an axis."""
    table = truth.sphere_table()
    table[:, :3] += rng.uniform(-1.0, 1.0, (len(table), 3))
    n = float(truth.spheres[0].medium.n(532.0) + rng.uniform(-0.01, 0.01))
    spheres = [
        replace(sphere, centre_mm=tuple(map(float, row[:3])), medium=ConstantMedium(n))
        for sphere, row in zip(truth.spheres, push_apart(table, 1e-5), strict=True)
    ]
    turn = Rotation.from_rotvec(np.deg2rad(rng.uniform(-0.5, 0.5, 3))).as_matrix()
    camera = truth.camera
    rotation = tuple(tuple(map(float, row)) for row in camera.rotation_matrix @ turn)
    position = tuple(float(p) for p in np.array(camera.position_mm) + rng.uniform(-1.0, 1.0, 3))
    return replace(
        nominal, camera=replace(nominal.camera, position_mm=position, rotation=rotation), bodies=tuple(spheres)
    )


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize(("name", "seed"), SCENES)
def test_random_starts_converge_or_say_so(name, seed):
    made = bench(name, seed)
    right, said = 0, []
    for number in range(STARTS):
        nominal = disturbed(made.truth, made.nominal, np.random.default_rng((2, number)))
        try:
            fit = fit_scene(nominal, made.frames, made.board)
        except FitError as error:
            said.append(f"{number}: {error}")
            continue
        masked = {one.name: str(one) for one in fit.verdict.unconfirmed if one.is_ball}
        for found, true in zip(fit.scene.spheres, made.truth.spheres, strict=True):
            off = np.abs(np.subtract(found.centre_mm, true.centre_mm)[:2]).max()
            assert off < 0.03 or found.name in masked, (number, found.name, off)
        said += [f"{number}: {words}" for words in masked.values()]
        right += not masked
    print(f"{name}: {right} of {STARTS} right; of the others it is said: {said}")
    assert right >= 0.95 * STARTS


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("start", [4, 35, 38])
def test_a_ball_that_shows_three_corners_is_found(start):
    """Alone, three corners are not missed among four hundred.

    Of start 35 wrong ones nearly fit; of start 38 one corner after the other leads to the place, in four steps.
    """
    made = bench("pyramid_500", 5)
    nominal = disturbed(made.truth, made.nominal, np.random.default_rng((2, start)))
    fit = fit_scene(nominal, made.frames, made.board)
    assert [line for line in fit.history if "elsewhere" in line.name]
    for found, true in zip(fit.scene.spheres, made.truth.spheres, strict=True):
        assert np.abs(np.subtract(found.centre_mm, true.centre_mm)[:2]).max() < 0.03
