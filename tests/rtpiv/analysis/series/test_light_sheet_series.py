"""A series of a flow in a light sheet off the target's plane: its scale, and what the sheet is unsure of."""

import numpy as np
import pytest

from correction.fitted.scene_sigma import KIND
from ground.map_file import save_arrays
from rtpiv.analysis.pairs.piv_file import piv_choice
from rtpiv.analysis.recipe import CorrectionRecipe
from rtpiv.analysis.series.run_series import run_series
from rtpiv.analysis.series.series_input import series_input
from rtpiv.analysis.series.series_mean import mean_of_series
from rtpiv.analysis.series.series_view import SeriesView
from tests.rtpiv.analysis.series.small_series import SCENE, flow_run
from tracer.scene.scene_file import load_scene

BY_EYE = "sheet: {sigma_mm: 0.5, tilt_sigma_deg: 0.5}\n"
EXACT = "sheet: {sigma_mm: 0.0, tilt_sigma_deg: 0.0}\n"
SHEET = "sheet: {z_mm: 5.0, sigma_mm: 1.0, tilt_sigma_deg: 0.0}\n"
CAMERA_MM = 500.0


def mean_in(folder, run, sheet):
    """Mean of the run with a scene known exactly but for its sheet."""
    folder.mkdir()
    scene = folder / "scene.yaml"
    scene.write_text(SCENE + sheet)
    known = load_scene(scene).content_hash()
    header = {"names": [], "scene_hash": known, "nominal_hash": known, "history": []}
    save_arrays(folder / "fit.npz", KIND, header, {"scene_root": np.zeros((14, 1))})
    choice = piv_choice(final_window_px=16, first_window_px=32)
    given = series_input(run, folder / "series", choice, scene, CorrectionRecipe(sigma_limit_px=5.0))
    run_series(given, 1, 4)
    return mean_of_series(SeriesView(folder / "series"))


def test_scale_and_sigma_are_those_of_the_sheet(tmp_path):
    run = flow_run(tmp_path, 4)
    at_target, at_sheet = (mean_in(tmp_path / name, run, text) for name, text in (("one", EXACT), ("two", SHEET)))
    ratio = np.nanmedian(at_sheet.mean_m_s[..., 0]) / np.nanmedian(at_target.mean_m_s[..., 0])
    assert ratio == pytest.approx(1.0 - 5.0 / CAMERA_MM, abs=1e-3)
    assert np.nanmax(at_target.map_sigma_m_s) < 1e-9
    # A millimetre of height is 1 / 495 of every length.
    share = at_sheet.map_sigma_m_s / np.abs(at_sheet.mean_m_s)
    assert np.nanmedian(share) == pytest.approx(1.0 / (CAMERA_MM - 5.0), rel=0.05)
    far_mm = np.nanmax(at_sheet.map_sigma_position_mm)
    assert 0.05 < far_mm < 0.2  # 50 mm beside the axis: 0.1 mm


def test_a_sheet_that_the_scene_does_not_name_is_unsure_by_half_a_millimetre(tmp_path):
    run = flow_run(tmp_path, 4)
    silent, said = (mean_in(tmp_path / name, run, text) for name, text in (("none", ""), ("eye", BY_EYE)))
    share = silent.map_sigma_m_s / np.abs(silent.mean_m_s)
    assert np.nanmin(share) == pytest.approx(0.5 / CAMERA_MM, rel=0.2)  # the tilt comes on top beside the axis
    np.testing.assert_array_equal(silent.map_sigma_m_s, said.map_sigma_m_s)
