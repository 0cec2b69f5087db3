import numpy as np
import pytest

from piv.errors import FrameError
from piv.preprocessing.image_figures import image_figures


def still(u, v):
    return 0 * u, 0 * u


@pytest.mark.parametrize("diameter_px", [2.0, 3.0, 4.0, 5.0])
def test_diameter_is_that_of_the_recorded_particle(particle_pair, diameter_px):
    frame, _ = particle_pair(still, diameter_px=diameter_px, ppp=0.01)
    recorded = np.sqrt(diameter_px**2 + 16 / 12)  # variances add: sigma = d/4 and 1/12 of a pixel
    figures = image_figures(frame, 4095)
    assert figures.diameter_u_px == pytest.approx(recorded, rel=0.03)
    assert figures.diameter_v_px == pytest.approx(recorded, rel=0.03)


@pytest.mark.parametrize("ppp", [0.005, 0.01, 0.02])
def test_particle_density_but_for_touching_images(particle_pair, ppp):
    frame, _ = particle_pair(still, ppp=ppp)
    assert 1 - 12 * ppp < image_figures(frame, 4095).particles_per_px / ppp < 1.06


def test_noise_and_signal_to_noise(particle_pair):
    low, high = (image_figures(particle_pair(still, ppp=0.01, noise=noise)[0], 4095) for noise in (0.01, 0.04))
    # Noise at the black level is not clipped with 100 counts below it at 1 %.
    assert low.noise == pytest.approx(0.01 * 4095, rel=0.15)
    assert low.signal_to_noise / high.signal_to_noise == pytest.approx(4, rel=0.25)
    assert low.background == pytest.approx(100, abs=15)


def test_elongated_particles_show_in_two_diameters(particle_pair):
    frame, _ = particle_pair(still, ppp=0.01)
    blurred = (frame[:, 1:-1] / 3 + frame[:, 2:] / 3 + frame[:, :-2] / 3).astype(np.float32)
    figures = image_figures(blurred, 4095)
    assert figures.diameter_u_px > 1.2 * figures.diameter_v_px


def test_saturation_histogram_mask_and_nan_are_counted(particle_pair):
    frame, _ = particle_pair(still, (128, 128), ppp=0.01)
    frame = np.minimum(frame.astype(np.float32), 3000)
    frame[:64] = 0
    frame[100, :10] = 3000
    frame[101, :7] = np.nan
    valid = np.ones(frame.shape, bool)
    valid[:64] = False
    figures = image_figures(frame, 3000, valid)
    assert figures.nan_pixels == 7
    assert figures.valid_pixels == 64 * 128 - 7
    assert figures.histogram.sum() == figures.valid_pixels
    assert figures.edges[[0, -1]].tolist() == [0.0, 3000.0]
    assert figures.saturated == np.count_nonzero(frame[64:] == 3000) / figures.valid_pixels > 0


def test_frames_without_particles_are_named():
    flat = np.full((32, 32), 7, np.uint8)
    with pytest.raises(FrameError, match="constant"):
        image_figures(flat, 255)
    with pytest.raises(FrameError, match="no pixel is valid"):
        image_figures(flat, 255, np.zeros((32, 32), bool))
    with pytest.raises(FrameError, match="True where valid"):
        image_figures(flat, 255, np.ones((31, 32), bool))
    with pytest.raises(FrameError, match="saturated pixel"):
        image_figures(flat, 0)
