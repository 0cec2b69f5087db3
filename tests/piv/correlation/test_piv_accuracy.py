"""What a vector is worth, on synthetic pairs with known displacement (0.02 per px, 3 px, 1 % noise)."""

import numpy as np
import pytest

from piv.correlation.settings import PivSettings
from piv.correlation.vector_field import VectorFlag
from tests.piv.correlation.flows import rms
from tests.piv.fixed_windows import evaluate_pair
from tests.slow_cases import slow


def uniform(du, dv):
    return lambda u, v: (du + 0 * u, dv + 0 * u)


def rotation(angle_rad, centre):
    return lambda u, v: (-angle_rad * (v - centre), angle_rad * (u - centre))


def shear(rate, centre):
    return lambda u, v: (rate * (v - centre), 0 * u)


def errors(field, displacement):
    du, dv = displacement(*np.moveaxis(field.grid_px, -1, 0))
    return np.stack([field.u_px - du, field.v_px - dv], -1)


def test_bias_nowhere_between_0_and_1_px_exceeds_5_thousandths(particle_pair):
    settings = PivSettings(uncertainty=False)
    worst = 0.0
    for shift in np.linspace(0, 1, 11):
        truth = uniform(shift, 1 - shift)
        field = evaluate_pair(*particle_pair(truth, (416, 416), seed=int(shift * 10)), settings=settings)
        assert field.valid.all()
        worst = max(worst, *np.abs(errors(field, truth).mean((0, 1))))
    assert worst <= 0.005


@pytest.mark.parametrize(
    "truth",
    [uniform(9.9, 9.9), uniform(-6.4, 3.3), rotation(0.02, 256), shear(0.025, 256)],
    ids=["uniform 9.9", "uniform -6.4 3.3", "rotation", "shear"],
)
def test_rms_error_up_to_the_frame_edge(particle_pair, truth):
    field = evaluate_pair(*particle_pair(truth, seed=4), settings=PivSettings(uncertainty=False))
    error = errors(field, truth)[field.flags != VectorFlag.MASKED]
    assert np.isfinite(error).all()
    assert rms(error) <= 0.008
    assert np.abs(error.mean(0)).max() <= 0.005


@pytest.mark.slow
def test_further_passes_hardly_amplify_noise(particle_pair):
    """A tenth from one refinement to five: what resolves shorter waves feeds some noise back."""
    truth = rotation(0.02, 200)
    figures = []
    for passes in (2, 3, 6):
        settings = PivSettings(windows_px=(64,) + (32,) * passes, uncertainty=False)
        off = [
            errors(evaluate_pair(*particle_pair(truth, (400, 400), seed=seed, noise=0.03, loss=0.05),
                                 settings=settings), truth)
            for seed in (8, 9, 10)
        ]  # fmt: skip
        figures.append(rms(off))
    assert max(figures) <= 1.12 * figures[0]
    assert figures[1] <= 1.05 * figures[0]  # the usual number


def test_signs_and_axes_are_right_down_and_pixel_centres(particle_pair):
    field = evaluate_pair(*particle_pair(uniform(3.0, -2.0), (160, 224)), settings=PivSettings(uncertainty=False))
    assert field.u_px.shape == (len(field.y_px), len(field.x_px)) == (9, 13)
    assert field.x_px[0] == 15.5
    assert field.y_px[0] == 15.5
    assert np.median(field.u_px) == pytest.approx(3.0, abs=0.01)
    assert np.median(field.v_px) == pytest.approx(-2.0, abs=0.01)


@pytest.mark.parametrize("texture", [False, True], ids=["black outside", "bright static texture outside"])
@pytest.mark.parametrize("truth", [uniform(9.9, 9.9), rotation(0.03, 256)], ids=["uniform", "rotation"])
def test_vectors_at_a_mask_edge(particle_pair, truth, texture):
    frame_a, frame_b = particle_pair(truth, seed=5)
    v, u = np.mgrid[:512, :512]
    valid = np.hypot(u - 255.5, v - 255.5) < 200
    rng = np.random.default_rng(0)
    outside = (rng.uniform(0, 4095, (512, 512)) if texture else np.zeros((512, 512))).astype(np.uint16)
    pair = np.where(valid, frame_a, outside), np.where(valid, frame_b, outside)
    field = evaluate_pair(*pair, valid, PivSettings(uncertainty=False))

    share = np.array(
        [[valid[int(y - 15.5) :][:32, int(x - 15.5) :][:, :32].mean() for x in field.x_px] for y in field.y_px]
    )
    error = errors(field, truth)
    edge = (share >= 0.4) & (share < 0.8) & (field.flags != VectorFlag.MASKED)
    assert edge.sum() >= 0.7 * ((share >= 0.4) & (share < 0.8)).sum()
    assert rms(error[edge]) <= 0.08
    assert np.abs(error[edge]).max() < 0.5
    assert rms(error[share == 1.0]) <= 0.008
    assert (field.flags[share < 0.3] == VectorFlag.MASKED).all()
    assert np.isnan(field.u_px[field.flags == VectorFlag.MASKED]).all()


CASES = [
    {"noise": 0.03}, {"loss": 0.1},
    *map(slow, ({"noise": 0.01}, {"noise": 0.1}, {"loss": 0.05}, {"loss": 0.2})),
]  # fmt: skip


@pytest.mark.parametrize("case", CASES, ids=str)
def test_sigma_is_the_size_of_the_true_error(particle_pair, case):
    # A weak rotation runs through all sub-pixel positions.
    def truth(u, v):
        return 3.3 + 0.004 * (v - 256), 1.7 - 0.004 * (u - 256)

    error, sigma = [], []
    for seed in (1, 2):
        field = evaluate_pair(*particle_pair(truth, seed=seed, **case))
        known = field.valid & np.isfinite(field.sigma_u_px) & np.isfinite(field.sigma_v_px)
        assert known.mean() > 0.99
        error.append(errors(field, truth)[known])
        sigma.append(field.total_sigma_px[known])
    error, sigma = np.concatenate(error), np.concatenate(sigma)
    # A little pair loss has long tails, and the filter takes most of what statistics fear: sigma is too large.
    tails = case.get("loss") in (0.05, 0.1)
    assert (0.75 if tails else 0.9) <= rms(error) / rms(sigma) <= 1.15
    assert 0.58 <= (np.abs(error) < sigma).mean() <= (0.84 if tails else 0.72)


def test_large_sigma_means_large_error(particle_pair):
    truth = uniform(2.3, 1.1)
    field = evaluate_pair(*particle_pair(truth, seed=3, loss=0.15))
    error, sigma = errors(field, truth)[..., 0][field.valid], field.sigma_u_px[field.valid]
    known = np.isfinite(sigma)
    quarter = np.quantile(sigma[known], [0.25, 0.75])
    quiet, loud = error[known & (sigma < quarter[0])], error[known & (sigma > quarter[1])]
    assert rms(loud) > 2.0 * rms(quiet)  # of single correlations 3: the last filter evens them out
