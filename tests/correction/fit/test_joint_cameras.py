"""Joint fit of cameras: against one dense solution of all data, and against a camera that stands elsewhere."""

from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.views import scene_at
from correction.fit.joint_cameras import MAX_GROWTH, JointFit, _combine, _growth, _residual, _tell
from tracer.bodies import translate_by
from tracer.strategies.sensitivity import landings

SHARED = ("ball.x", "ball.y", "ball.z", "glass BK7.n")
SIGMAS = np.array([1.0, 1.0, 2.0, 1e-3])
ROWS = 40


def linear_camera(rng, truth, noise=0.1, off=0.0, heights=1):
    """Data and posterior of a camera whose residuals are linear in six numbers of its own and four shared ones."""
    own = tuple(f"camera.{k}" for k in range(3)) + tuple(f"target+{k}mm.z" for k in range(heights))
    full = (*own[:3], "ball.x", "ball.y", "ball.z", "a.n", "b.n", *own[3:])
    names = (*own[:3], *SHARED[:3], *own[3:], SHARED[3])
    columns = np.zeros((len(full), len(names)))
    for place, name in enumerate(names):
        rows = ("a.n", "b.n") if name == SHARED[3] else (name,)
        for row in rows:
            columns[full.index(row), place] = SIGMAS[SHARED.index(name)] if name in SHARED else 1.0
    start = rng.normal(0.0, 1.0, len(full))
    start[3:8] = (1.0, 2.0, 3.0, 1.5, 1.5)
    design = rng.normal(0.0, 1.0, (ROWS, len(names)))
    design[:, names.index("ball.z")] *= 0.01 + heights  # one of two hardly sees the depth
    x = rng.normal(0.0, 1.0, len(names))
    x[[names.index(name) for name in SHARED]] = truth + off
    data = design @ x + noise * rng.standard_normal(ROWS)
    covariance = np.linalg.inv(design.T @ design / noise**2 + np.eye(len(names)))
    found = covariance @ design.T @ data / noise**2
    unknowns = SimpleNamespace(
        names=names, full_names=full, columns=columns, start=start, sigma=np.abs(columns).max(axis=0),
        full=lambda x: start + columns @ x,
    )  # fmt: skip
    fit = SimpleNamespace(names=names, unknowns=unknowns, x=found, root=columns @ np.linalg.cholesky(covariance))
    return fit, design / noise, data / noise, truth


def told_of(cameras):
    first = cameras[0][0].unknowns
    columns = first.columns[:, [first.names.index(name) for name in SHARED]]
    rows = [name for name, row in zip(first.full_names, columns, strict=True) if row.any()]
    return [_tell(fit, first.start, columns, rows, SHARED) for fit, *_ in cameras]


@pytest.mark.parametrize("count", [2, 3])
def test_joined_fits_are_one_solution_of_all_data(count):
    rng = np.random.default_rng(count)
    truth = rng.normal(0.0, 1.0, len(SHARED))
    cameras = [linear_camera(rng, truth, heights=1 + k) for k in range(count)]
    joint, precision = _combine(told_of(cameras))
    # All data and the prior at once, every camera with columns of its own.
    private = [[name for name in fit.names if name not in SHARED] for fit, *_ in cameras]
    size = len(SHARED) + sum(map(len, private))
    design, data, at = [np.eye(size)], [np.zeros(size)], len(SHARED)
    for (fit, rates, values, _), own in zip(cameras, private, strict=True):
        block = np.zeros((ROWS, size))
        for place, name in enumerate(fit.names):
            block[:, SHARED.index(name) if name in SHARED else at + own.index(name)] = rates[:, place]
        design, data, at = [*design, block], [*data, values], at + len(own)
    design, data = np.concatenate(design), np.concatenate(data)
    wanted = np.linalg.lstsq(design, data, rcond=None)[0][: len(SHARED)]
    covariance = np.linalg.inv(design.T @ design)[: len(SHARED), : len(SHARED)]
    np.testing.assert_allclose(joint, wanted, atol=1e-6)
    np.testing.assert_allclose(np.linalg.inv(precision), covariance, rtol=1e-5, atol=1e-9)


def test_residual_is_one_and_rises_where_a_camera_sees_other_glass():
    rng = np.random.default_rng(5)

    def residual(off):
        truth = rng.normal(0.0, 1.0, len(SHARED))
        cameras = [linear_camera(rng, truth, off=off * (k == 2), heights=1 + k) for k in range(3)]
        return _residual(told_of(cameras)), _residual(told_of(cameras[:2]))

    quiet = np.array([residual(0.0) for _ in range(100)])
    assert np.sqrt(np.mean(np.square(quiet))) == pytest.approx(1.0, abs=0.1)
    moved, others = np.array([residual(0.2) for _ in range(10)]).T
    assert moved.min() > 2.0
    assert others.max() < 2.0


def test_glass_that_does_not_fit_the_corners_of_a_camera_is_refused():
    scene = scene_at("two", 0.0, 252)
    moved = scene.with_bodies([body.moved(translate_by((0.03, 0.0, 0.0))) for body in scene.bodies])
    pixel = np.stack(np.meshgrid(np.linspace(105.0, 145.0, 9), np.linspace(105.0, 145.0, 9)), axis=-1).reshape(
        -1, 2
    )
    shown, fitted = landings(scene, pixel), pixel.copy()
    for _ in range(4):  # where the moved balls show the same
        fitted += landings(moved, fitted).step_px(shown)
    noise = np.random.default_rng(1).normal(0.0, 0.02, pixel.shape)

    def fit(of_scene, residual_px):
        used = np.ones(len(pixel), bool)
        corners = SimpleNamespace(inlier=used, behind=used, pixel=pixel, residual_px=residual_px)
        return SimpleNamespace(scene=of_scene, corners=corners)

    right, wrong = fit(scene, noise), fit(moved, pixel - fitted + noise)
    assert _growth(right, right) == pytest.approx(1.0)
    assert _growth(right, wrong) > MAX_GROWTH
    assert _growth(wrong, right) == 1.0
    joint = JointFit((), (), np.ones(1), np.ones((2, 1)), 1.2, growth=(1.0, _growth(right, wrong)))
    assert "residuals of camera 2" in joint.warning
    assert JointFit((), (), np.ones(1), np.ones((2, 1)), 1.2, growth=(1.0, 1.1)).warning == ""
