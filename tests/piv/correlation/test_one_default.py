"""A pair in Python is evaluated as the command does it, with the same bits, on as many cores as are asked for."""

import os
import time
from dataclasses import replace

import numpy as np
import pytest

from ground.blas import _get_and_set, _libraries, one_blas_thread
from piv.correlation.pair import evaluate_pair
from piv.correlation.settings import FOUND_WINDOWS, PivSettings
from rtpiv.analysis.pairs.piv_file import piv_choice
from tests.piv.conftest import make_pair


@pytest.fixture(scope="module")
def pair():
    return make_pair(lambda u, v: (3.0 + 1.5 * np.sin(u / 9.0), 0.0 * v), (192, 192), seed=3)


def test_python_has_the_default_of_the_command(pair):
    assert piv_choice().settings == FOUND_WINDOWS
    for frames in (pair, [frame.astype(np.float32) for frame in pair]):
        found, same, fixed = (
            evaluate_pair(*frames, settings=each) for each in (None, FOUND_WINDOWS, PivSettings())
        )
        np.testing.assert_array_equal(found.u_px, same.u_px)
        np.testing.assert_array_equal(found.sigma_u_px, same.sigma_u_px)
        assert found.u_px.shape != fixed.u_px.shape


@pytest.mark.parametrize("settings", [FOUND_WINDOWS, PivSettings()])
def test_unfiltered_vectors_are_those_of_an_evaluation_without_the_noise_filter(pair, settings):
    found, rough = (evaluate_pair(*pair, settings=each) for each in (settings, replace(settings, denoise=0.0)))
    both = found.valid & rough.valid
    assert both.mean() > 0.9
    for axis, along in enumerate("uv"):
        np.testing.assert_array_equal(found.unfiltered_px[both][:, axis], getattr(rough, f"{along}_px")[both])
    assert (found.unfiltered_px[both][:, 0] != found.u_px[both]).any()
    noise = np.hypot(rough.sigma_u_px, rough.sigma_v_px)[both] / np.sqrt(2.0)
    np.testing.assert_allclose(found.unfiltered_sigma_px[both], noise, rtol=0.02)
    assert (found.unfiltered_steady_px[both] <= found.steady_px[both]).all()
    assert np.isnan(found.unfiltered_px[~found.valid]).all()
    assert rough.unfiltered_px is None
    assert evaluate_pair(*pair, settings=replace(settings, uncertainty=False)).unfiltered_px is None


def blas_threads():
    return [found[0]() for path in sorted(_libraries()) if (found := _get_and_set(path)) is not None]


@pytest.mark.skipif(not blas_threads(), reason="NumPy has another library than OpenBLAS here")
def test_openblas_has_one_thread_within_and_as_many_as_before_after(pair):
    libraries = [found for path in _libraries() if (found := _get_and_set(path)) is not None]
    before = blas_threads()
    try:
        for count in (2, 3):
            for _, set_threads in libraries:
                set_threads(count)
            with one_blas_thread():
                assert set(blas_threads()) == {1}
                with one_blas_thread():
                    assert set(blas_threads()) == {1}
                assert set(blas_threads()) == {1}
            assert set(blas_threads()) == {count}
            with pytest.raises(ZeroDivisionError), one_blas_thread():
                raise ZeroDivisionError
            assert set(blas_threads()) == {count}
    finally:
        for (_, set_threads), count in zip(libraries, before, strict=True):
            set_threads(count)


def test_one_thread_is_one_core(pair):
    """CPU time never exceeds the time on the clock by more than what begins and ends a measurement."""
    evaluate_pair(*pair, threads=1)
    wall_s, cpu_s = time.perf_counter(), time.process_time()
    for _ in range(3):
        evaluate_pair(*pair, threads=1)
    wall_s, cpu_s = time.perf_counter() - wall_s, time.process_time() - cpu_s
    assert cpu_s < 1.15 * wall_s or os.cpu_count() == 1
