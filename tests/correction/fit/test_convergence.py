"""Fits begun beside the truth: found, or refused, or a ball masked by name; never wrong in silence.

Near starts are off by a millimetre, far ones by up to five; ten balls in a tube have a tube that is not as told.
"""

import os
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from correction.errors import FitError
from correction.fit.judge.result import SceneFit
from correction.fit.judge.weakness import weaknesses
from correction.fit.scene_fit import fit_scene
from correction.fit.solve.contact import push_apart
from correction.target import Chessboard
from sim.demo.scenes import misalign
from tests.correction.fit.benches import Unknowns, bench, photograph
from tracer.bodies import Sphere
from tracer.camera import Camera
from tracer.media import shifted
from tracer.scene.scene import Scene
from tracer.scene.scene_file import load_scene

STARTS = int(os.environ.get("STARTS", "10"))  # of the 200 that docs/adr/0005 reports; 2 to 10 s of a core each
NEAR = [("one_sphere_250", 7), ("two_spheres_500", 6), ("three_spheres_500", 3), ("pyramid_500", 5)]
FAR = [("pair_off_axis", 4), *NEAR[1:]]
FAR_MM, OFF_MM, TUBE = 5.0, 0.03, "tube"
COLUMN = Path(__file__).resolve().parents[3] / "examples" / "column_in_tube.yaml"
SQUARE_MM, COLUMN_PX = 1.0, 700


def balls_at(truth: Scene, table: np.ndarray, n: float) -> list[Sphere]:
    """The true balls at other places, but clear of each other, of a glass that is off by n."""
    rows = push_apart(table, 1e-5)[:, :3].tolist()
    return [
        replace(ball, centre_mm=tuple(row), medium=shifted(ball.medium, n))
        for ball, row in zip(truth.spheres, rows, strict=True)
    ]


def camera_off(nominal: Scene, truth: Scene, move_mm: np.ndarray, turn_deg: np.ndarray) -> Camera:
    """The true camera, moved and turned."""
    turn = Rotation.from_rotvec(np.deg2rad(turn_deg)).as_matrix()
    rotation = tuple(map(tuple, (truth.camera.rotation_matrix @ turn).tolist()))
    position = tuple((np.array(truth.camera.position_mm) + move_mm).tolist())
    return replace(nominal.camera, position_mm=position, rotation=rotation)


def near_start(made: Unknowns, seed: int) -> Scene:
    """Every centre off by up to 1 mm an axis, n by 0.01, the camera by 1 mm and 0.5 deg an axis."""
    rng, table = np.random.default_rng((2, seed)), made.truth.sphere_table()
    table[:, :3] += rng.uniform(-1.0, 1.0, (len(table), 3))
    balls = balls_at(made.truth, table, float(rng.uniform(-0.01, 0.01)))
    turn_deg, move_mm = rng.uniform(-0.5, 0.5, 3), rng.uniform(-1.0, 1.0, 3)
    return replace(
        made.nominal, camera=camera_off(made.nominal, made.truth, move_mm, turn_deg), bodies=tuple(balls)
    )


def far_start(made: Unknowns, seed: int) -> Scene:
    """Even seeds move all balls alike, odd ones one; n off by up to 0.02, the camera by up to 2 degrees."""
    rng, table = np.random.default_rng((7, seed)), made.truth.sphere_table()
    way = rng.normal(size=3)
    move = way * FAR_MM * rng.uniform(0.2, 1.0) / np.linalg.norm(way)
    table[slice(None) if seed % 2 == 0 else rng.integers(len(table)), :3] += move
    balls = balls_at(made.truth, table, float(rng.uniform(-0.02, 0.02)))
    camera = camera_off(made.nominal, made.truth, np.zeros(3), rng.uniform(-2.0, 2.0, 3))
    return replace(made.nominal, camera=camera, bodies=tuple(balls))


def wrong_balls(fit: SceneFit, truth: Scene, sigmas: float) -> list[str]:
    """Balls that are not where they should be, but for those masked by name, or said to be what the file says.

    Without sigmas heights are not judged: a single plane hardly tells them.
    """
    known = dict(zip(fit.names, fit.sigmas.tolist(), strict=True))
    said = [weakness.names for weakness in weaknesses(fit) if "no corner is seen through" in weakness.sentence]
    wrong = []
    for found, true in zip(fit.scene.spheres, truth.spheres, strict=True):
        unseen = any(f"{found.name}.x" in names for names in said)
        off = np.abs(np.subtract(found.centre_mm, true.centre_mm))
        limit = np.array([OFF_MM + sigmas * known[f"{found.name}.{axis}"] for axis in "xyz"])
        if not unseen and found.name not in masked(fit) and np.any((off > limit)[: 3 if sigmas else 2]):
            wrong.append(f"{found.name} off by {off}, limit {limit}")
    return wrong


def masked(fit: SceneFit) -> list[str]:
    return [one.name for one in fit.verdict.unconfirmed if one.is_ball]


def begun(made: Unknowns, starts: list[Scene], sigmas: float) -> tuple[int, list[str]]:
    """How many starts are right, and the words of those refused; none may be wrong."""
    right, refused = 0, []
    for number, nominal in enumerate(starts):
        try:
            fit = fit_scene(nominal, made.frames, made.board)
        except FitError as error:
            refused.append(str(error))
            continue
        assert not wrong_balls(fit, made.truth, sigmas), number
        right += not masked(fit)
    print(f"{right} of {len(starts)} right; refused: {refused}")
    return right, refused


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize(("name", "seed"), NEAR)
def test_random_starts_converge_or_say_so(name, seed):
    made = bench(name, seed)
    right, _ = begun(made, [near_start(made, number) for number in range(STARTS)], sigmas=0.0)
    assert right >= 0.95 * STARTS


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize(("name", "seed"), FAR)
def test_balls_told_far_beside_their_places_are_found_or_refused_by_name(name, seed):
    made = bench(name, seed)
    right, refused = begun(made, [far_start(made, number) for number in range(STARTS)], sigmas=4.0)
    assert all("seen" in words or "sigma" in words or "corners through" in words for words in refused)
    assert right >= 0.8 * STARTS


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("start", [4, 35, 38])
def test_a_ball_that_shows_three_corners_is_found(start):
    """Alone, three corners are not missed among four hundred.

    Of start 35 wrong ones nearly fit; of start 38 one corner after the other leads to the place, in four steps.
    """
    made = bench("pyramid_500", 5)
    fit = fit_scene(near_start(made, start), made.frames, made.board)
    assert [line for line in fit.history if "elsewhere" in line.name]
    for found, true in zip(fit.scene.spheres, made.truth.spheres, strict=True):
        assert np.abs(np.subtract(found.centre_mm, true.centre_mm)[:2]).max() < OFF_MM


@cache
def column() -> Unknowns:
    """Ten balls in a tube, the true ones and the true tube, and frames of both."""
    scene = load_scene(COLUMN)
    ball = scene.spheres[0]
    more = [
        replace(ball, name=f"b{number}", centre_mm=(x, -4.34, 19.76)) for number, x in ((9, -7.51), (10, 7.51))
    ]
    nominal = scene.with_bodies([*scene.bodies, *more]).with_camera(scene.camera.with_width(COLUMN_PX))
    truth = misalign(nominal, 2)
    bodies = [
        body.with_numbers([0.1, -0.1, 0.002, -0.001, 50.1, 45.05, body.media[0][1].n(532.0)], 532.0)
        if body.name == TUBE
        else body
        for body in truth.bodies
    ]
    truth = truth.with_bodies(bodies)
    frames = [photograph(truth.bare(), False, 0.0, 1, SQUARE_MM)]
    frames += [photograph(truth, True, z, 2 + k, SQUARE_MM) for k, z in enumerate((0.0, -5.0))]
    return Unknowns(nominal, truth, tuple(frames), Chessboard(SQUARE_MM, 0.4 * SQUARE_MM))


def start_in_tube(made: Unknowns, seed: int) -> Scene:
    """Every centre off by up to 0.3 mm an axis, the camera by 1 mm, the tube by tenths of a mm and a degree."""
    rng, table = np.random.default_rng((11, seed)), made.truth.sphere_table()
    table[:, :3] += rng.uniform(-0.3, 0.3, (len(table), 3))
    rows, bodies = iter(push_apart(table, 1e-5)[:, :3].tolist()), []
    for body in made.nominal.bodies:
        if isinstance(body, Sphere):
            bodies.append(replace(body, centre_mm=tuple(next(rows))))
        else:
            values = [number.value for number in body.numbers(532.0)]
            off = rng.uniform(-1.0, 1.0, len(values)) * [0.3, 0.3, 0.005, 0.005, 0.2, 0.2, 0.002]
            bodies.append(body.with_numbers((np.array(values) + off).tolist(), 532.0))
    camera = camera_off(made.nominal, made.truth, rng.uniform(-1.0, 1.0, 3), np.zeros(3))
    return replace(made.nominal, camera=camera, bodies=tuple(bodies))


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_ten_balls_in_a_tube_are_found_or_refused() -> None:
    made, count = column(), 1 + STARTS // 10  # half a minute to three minutes of a core each
    right, _ = begun(made, [start_in_tube(made, seed) for seed in range(count)], sigmas=4.0)
    assert right >= 0.95 * count
