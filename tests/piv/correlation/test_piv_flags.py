"""Masked, replaced, rejected and impossible: each by its name, nothing silently."""

from contextlib import suppress

import numpy as np
import pytest

from piv.correlation.pair import evaluate_pair
from piv.correlation.settings import PivSettings
from piv.correlation.vector_field import VectorFlag
from piv.errors import FrameError, PairError, PivError

PLAIN = PivSettings(uncertainty=False)


@pytest.fixture(scope="module")
def pair(particle_pair):
    return particle_pair(lambda u, v: (2.3 + 0 * u, -1.4 + 0 * u), (224, 256), seed=6)


def test_a_wrong_patch_is_replaced_flagged_and_close_to_its_neighbours(pair):
    a, b = pair
    rng = np.random.default_rng(2)
    b = b.copy()
    b[96:160, 96:160] = rng.permutation(b[96:160, 96:160].ravel()).reshape(64, 64)  # decorrelated
    field = evaluate_pair(a, b, settings=PivSettings(peak_ratios=True))
    y, x = np.argmin(np.abs(field.y_px - 128)), np.argmin(np.abs(field.x_px - 128))
    assert field.flags[y, x] == VectorFlag.REPLACED
    assert field.u_px[y, x] == pytest.approx(2.3, abs=0.1)
    assert np.isnan(field.sigma_u_px[y, x])
    assert np.isfinite(field.peak_ratio[y, x])
    assert field.peak_ratio[y, x] < np.median(field.peak_ratio)
    assert field.counts["replaced"] == np.count_nonzero(field.flags == VectorFlag.REPLACED) <= 25
    assert sum(field.counts.values()) == field.flags.size


def test_nan_pixels_are_masked_and_counted(pair):
    a, b = (frame.astype(np.float32) for frame in pair)
    a[60:100, 60:100] = np.nan
    b[5, 7] = np.inf
    field = evaluate_pair(a, b, settings=PLAIN)
    assert field.nan_pixels == 1601
    y, x = np.argmin(np.abs(field.y_px - 80)), np.argmin(np.abs(field.x_px - 80))
    assert field.flags[y, x] == VectorFlag.MASKED
    assert np.nanmax(np.abs(field.u_px - 2.3)) < 0.1
    known_bad = np.isfinite(a) & np.isfinite(b)
    assert evaluate_pair(a, b, known_bad, PLAIN).nan_pixels == 0


def test_a_window_without_texture_is_not_a_measurement(pair):
    a, b = (frame.copy() for frame in pair)
    a[64:192, 64:192] = b[64:192, 64:192] = 100
    field = evaluate_pair(a, b, settings=PLAIN)
    middle = field.flags[np.ix_((field.y_px > 100) & (field.y_px < 156), (field.x_px > 100) & (field.x_px < 156))]
    assert middle.size
    assert set(middle.ravel()) == {VectorFlag.STILL}
    assert np.isnan(field.u_px[field.flags == VectorFlag.REJECTED]).all()


def test_the_same_bits_for_any_number_of_threads(pair):
    one, three = (evaluate_pair(*pair, threads=threads) for threads in (1, 3))
    for name in ("u_px", "v_px", "flags", "peak_ratio", "correlation", "sigma_u_px", "sigma_v_px"):
        assert np.array_equal(getattr(one, name), getattr(three, name), equal_nan=True)


@pytest.mark.parametrize("dtype", [np.uint8, np.float32, np.float64])
def test_kinds_of_numbers(pair, dtype):
    frames = [(frame / 16).astype(dtype) for frame in pair]
    field = evaluate_pair(*frames, settings=PLAIN)
    assert np.median(field.u_px) == pytest.approx(2.3, abs=0.02)


def test_free_window_sizes_and_overlap(pair):
    field = evaluate_pair(*pair, settings=PivSettings(windows_px=(60, 40, 25), overlap=0.75))
    assert (field.window_px, field.step_px) == (25, 6)
    assert np.median(field.v_px) == pytest.approx(-1.4, abs=0.02)
    assert (np.diff(field.x_px) == 6).all()
    single = evaluate_pair(*pair, settings=PivSettings(windows_px=(32,), overlap=0.0))
    assert single.u_px.shape == (7, 8)


def test_pairs_that_are_none_are_named(pair):
    a, b = pair
    nothing = np.zeros(a.shape, bool)
    with pytest.raises(PairError, match=r"\(224, 256\) and frame B \(224, 255\)"):
        evaluate_pair(a, b[:, :-1])
    with pytest.raises(PairError, match="no pixel is valid"):
        evaluate_pair(a, b, nothing)
    with pytest.raises(PairError, match=r"bool \(224, 256\)"):
        evaluate_pair(a, b, nothing.astype(np.uint8))
    with pytest.raises(PairError, match=r"bool \(224, 256\)"):
        evaluate_pair(a, b, nothing[1:])
    with pytest.raises(PairError, match=r"frame B is constant \(7\)"):
        evaluate_pair(a, np.full_like(b, 7))
    with pytest.raises(PairError, match="no pixel is valid"):
        evaluate_pair(np.full(a.shape, np.nan), b)
    with pytest.raises(PairError, match="64 px does not fit a frame of 256 x 50"):
        evaluate_pair(a[:50], b[:50])
    thin = nothing.copy()
    thin[::11] = True
    with pytest.raises(PairError, match="no window holds 30% valid pixels"):
        evaluate_pair(a, b, thin)
    with pytest.raises(FrameError, match="2-D"):
        evaluate_pair(a[None], b)
    assert issubclass(PairError, PivError)


@pytest.mark.parametrize(
    ("bad", "words"),
    [
        ({"windows_px": ()}, "windows_px"),
        ({"windows_px": (64, 4)}, "windows_px"),
        ({"overlap": 1.0}, "overlap"),
        ({"overlap": -0.1}, "overlap"),
        ({"min_valid": 0.0}, "min_valid"),
    ],
)
def test_settings_that_cannot_work_are_named(bad, words):
    with pytest.raises(PairError, match=words):
        PivSettings(**bad)


@pytest.mark.filterwarnings("error")
def test_frames_whose_light_lies_apart_give_no_warning_of_numpy(particle_pair):
    """Windows that are constant in one frame have no correlation, of which no median can be taken."""
    for seed in range(3, 63, 10):
        side = int(np.random.default_rng(seed).integers(36, 160))
        a, b = particle_pair(
            lambda u, v: (1.0 + 0 * u, 1.0 + 0 * v), (side, side), seed=seed, ppp=0.003, noise=0.0
        )
        a[:, : side // 2] = 100
        b[:, side // 2 :] = 100
        with suppress(PairError):
            evaluate_pair(a, b)
