"""Settings of the correlation from a file and from the command line."""

import pytest

from ground.errors import ConfigError
from piv.correlation.settings import PivSettings
from piv.errors import PairError
from piv.preprocessing.preparation import Preparation
from rtpiv.analysis.pairs.piv_file import piv_choice, windows_of


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
    assert piv_choice().settings == PivSettings(finest_px=16)
    assert piv_choice(passes=1).settings == PivSettings(windows_px=(32,))
    assert piv_choice(final_window_px=32).settings == PivSettings()
    assert piv_choice().preparation is None


def test_the_command_line_wins(tmp_path):
    path = tmp_path / "piv.yaml"
    path.write_text("final_window_px: 16\noverlap: 0.75\nwindow: square\n")
    from_file = piv_choice(piv=path).settings
    assert (from_file.windows_px, from_file.overlap, from_file.window_sigma) == ((64, 32, 16, 16, 16), 0.75, 0.0)
    both = piv_choice(piv=path, overlap=0.25, window="gaussian").settings
    assert (both.finest_px, piv_choice(piv=path, finest_window_px=8).settings.finest_px) == (None, 8)
    assert (both.windows_px[-1], both.overlap, both.window_sigma) == (16, 0.25, PivSettings.window_sigma)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("final_windw_px: 16\n", "did you mean 'final_window_px'"),
        ("finest_window_px: 32\n", "smaller than the last"),
        ("overlap: 1.0\n", "overlap"),
        ("smoothing_px: .nan\n", "finite"),
        ("final_window_px: 4\n", "final_window_px"),
        ("first_window_px: 16\n", "smaller than the last"),
        ("prepare: [clahe]\n", "moves correlation peaks"),
        ("prepare: sliding-minimum\n", "prepare"),
        ("prepare: [min-max, sliding-minimum]\n", "raw frames come first"),
    ],
)
def test_what_makes_no_sense_is_refused_with_its_file(tmp_path, text, said):
    path = tmp_path / "piv.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=said) as caught:
        piv_choice(piv=path)
    assert "piv.yaml" in str(caught.value)


def test_a_senseless_option_is_refused_by_name():
    with pytest.raises(ConfigError, match="overlap"):
        piv_choice(overlap=1.5)


def test_what_is_done_to_frames_comes_from_the_file_or_the_line(tmp_path):
    path = tmp_path / "piv.yaml"
    path.write_text("prepare: [sliding-minimum, min-max]\n")
    assert piv_choice(piv=path).preparation == Preparation(("sliding-minimum", "min-max"))
    assert piv_choice(piv=path, prepare=("pod",)).preparation == Preparation(("pod",))
    assert piv_choice(piv=path, prepare=()).preparation == Preparation(())
