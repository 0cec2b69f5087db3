"""Settings of the correlation from a file and from the command line."""

import pytest

from correction.errors import PairError
from correction.piv.settings import PivSettings
from daq.analysis.piv_file import piv_settings, windows_of
from ground.errors import ConfigError


@pytest.mark.parametrize(
    ("first", "final", "passes", "sides"),
    [
        (None, 32, None, (64, 32, 32, 32)),
        (None, 16, None, (64, 32, 16, 16, 16)),
        (None, 64, None, (128, 64, 64, 64)),
        (128, 24, None, (128, 64, 32, 24, 24, 24)),
        (None, 32, 6, (64, 32, 32, 32, 32, 32)),
        (None, 32, 1, (32,)),
        (48, 48, 2, (48, 48)),
    ],
)
def test_windows_come_down_to_the_last(first, final, passes, sides):
    assert windows_of(first, final, passes) == sides


@pytest.mark.parametrize(("first", "final", "passes"), [(32, 64, None), (256, 16, 3)])
def test_windows_that_cannot_be(first, final, passes):
    with pytest.raises(PairError):
        windows_of(first, final, passes)


def test_nothing_given_is_the_default():
    assert piv_settings() == PivSettings()


def test_the_command_line_wins(tmp_path):
    path = tmp_path / "piv.yaml"
    path.write_text("final_window_px: 16\noverlap: 0.75\nwindow: square\n")
    from_file = piv_settings(path)
    assert (from_file.windows_px, from_file.overlap, from_file.window_sigma) == ((64, 32, 16, 16, 16), 0.75, 0.0)
    both = piv_settings(path, overlap=0.25, window="gaussian")
    assert (both.windows_px[-1], both.overlap, both.window_sigma) == (16, 0.25, PivSettings.window_sigma)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("final_windw_px: 16\n", "did you mean 'final_window_px'"),
        ("overlap: 1.0\n", "overlap"),
        ("smoothing_px: .nan\n", "finite"),
        ("final_window_px: 4\n", "final_window_px"),
        ("first_window_px: 16\n", "smaller than the last"),
    ],
)
def test_what_makes_no_sense_is_refused_with_its_file(tmp_path, text, said):
    path = tmp_path / "piv.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=said) as caught:
        piv_settings(path)
    assert "piv.yaml" in str(caught.value)


def test_a_senseless_option_is_refused_by_name():
    with pytest.raises(ConfigError, match="overlap"):
        piv_settings(overlap=1.5)
