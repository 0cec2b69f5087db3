"""The verdict on a calibration in the pages that are made with it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.quiver import Quiver

from correction.fit.judge.weakness import Weakness
from correction.fitted.scene_sigma import KIND, StoredVerdict, load_verdict, save_fit
from ground.errors import MapFileError
from ground.map_file import load_arrays, save_arrays
from rtpiv.analysis.calibration import Calibration
from rtpiv.analysis.pictures.calibration import smooth_figure
from rtpiv.analysis.report.calibration import _numbers, calibration_chapter, mask_table
from rtpiv.analysis.report.page import Page
from tests.correction.fit.drawn_labs import drawn_lab
from tests.correction.small_scenes import small_scene
from tracer.masked import UNCONFIRMED, UNLISTED, MaskedPart


@pytest.fixture(scope="module")
def fit():
    return drawn_lab(205, "ellipsoid").fit


def page_of(path, scene, out) -> str:
    page = Page("a page")
    calibration_chapter(page, path, scene)
    page.write(out / "page.html")
    return (out / "page.html").read_text()


@pytest.mark.slow
def test_a_wrong_model_stands_in_the_page_as_a_warning_with_its_picture(fit, tmp_path):
    save_fit(tmp_path / "fit.npz", fit)
    found = load_verdict(tmp_path / "fit.npz")
    assert not found.right
    assert found.sentences == fit.verdict.sentences
    np.testing.assert_array_equal(np.array(found.ways)[found.way], fit.corners.branch_name)
    np.testing.assert_array_equal(found.smooth_px, fit.verdict.smooth_px)
    text = page_of(tmp_path / "fit.npz", fit.measured_scene, tmp_path)
    assert 'class="warning"' in text
    assert "is not the sphere of the file" in text
    assert "data:image/png" in text


@pytest.mark.slow
def test_the_chapter_of_another_scene_or_of_none_is_left_out(fit, tmp_path):
    save_fit(tmp_path / "fit.npz", fit)
    assert "Calibration" not in page_of(tmp_path / "fit.npz", fit.unknowns.scene, tmp_path)
    assert "Calibration" not in page_of(tmp_path / "none.npz", fit.measured_scene, tmp_path)


@pytest.mark.slow
def test_every_way_with_corners_enough_has_a_panel_and_no_corners_are_no_picture(fit):
    found = StoredVerdict.of(fit)
    titles = [axes.get_title() for axes in smooth_figure(found).axes if axes.get_title()]
    assert titles[0].startswith("beside the glass")
    assert len(titles) == sum(np.count_nonzero(found.way == n) >= 12 for n in range(len(found.ways)))
    only, others = (
        [axes.get_title() for axes in smooth_figure(found, which).axes if axes.get_title()]
        for which in ("first", "others")
    )
    assert len(only) == 1
    assert not only[0].startswith("beside")
    assert sorted(only + others) == sorted(titles)  # on a page with both each view stands once
    arrows = [part for axes in smooth_figure(found).axes for part in axes.collections if isinstance(part, Quiver)]
    assert max(len(part.U) for part in arrows) <= 18**2
    nothing = StoredVerdict("", True, (), (), np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros((0, 2)))
    assert smooth_figure(nothing) is None


def test_a_smooth_part_too_small_to_matter_is_not_blown_up(fit):
    found = StoredVerdict.of(fit)
    still = smooth_figure(replace(found, smooth_px=1e-7 * found.smooth_px), "first")
    (arrows,) = (part for axes in still.axes for part in axes.collections if isinstance(part, Quiver))
    assert arrows.get_clim() == (0.0, 1e-4)
    assert any(axes.get_title().endswith("less than 0.0001 px rms") for axes in still.axes)


@pytest.mark.parametrize("harm", ["older", "way", "size", "text"])
def test_a_fit_file_that_does_not_hold_together_is_refused_and_said_in_the_page(fit, harm, tmp_path):
    path = tmp_path / "fit.npz"
    save_fit(path, fit)
    header, arrays = load_arrays(path, KIND)
    if harm == "older":
        del header["verdict"]
    elif harm == "way":
        arrays["corner_way"][3] = len(header["ways"])
    elif harm == "size":
        arrays["smooth_px"] = arrays["smooth_px"][:-1]
    else:
        header["verdict"] = "right"
    save_arrays(path, KIND, header, arrays)
    with pytest.raises(MapFileError, match=r"calibration again|verdict"):
        load_verdict(path)
    assert "calibration again" in page_of(path, fit.measured_scene, tmp_path) or harm == "text"


@pytest.mark.parametrize(
    ("value", "sigma", "said"),
    [
        (500.2854913, 4.13e-4, ("500.28549", "0.00041")),
        (25.0, 0.082, ("25.000", "0.082")),
        (3412.7, 12.0, ("3413", "12")),
    ],
)
def test_numbers_stand_to_the_second_digit_of_their_sigma(value, sigma, said):
    row = {"value": value, "sigma": sigma, "moved": 0.0, "prior_sigma": 2.0}
    assert _numbers(row)[:2] == said


def test_what_is_masked_is_listed_with_its_reason_and_place():
    square = ((10.0, 20.0), (43.6, 20.0), (43.6, 53.6), (10.0, 53.6))
    parts = (MaskedPart(UNLISTED, square), MaskedPart(UNCONFIRMED, through=("sphere2", "sphere1")))
    scene, page = small_scene("two_spheres_500"), Page("a page")
    mask_table(page, scene)
    assert "leaves out" not in page.html()
    mask_table(page, replace(scene, masked=parts))
    said = page.html()
    assert "behind an unlisted body</td><td>around pixel (27, 37)</td><td>34 x 34 px, 1 % of the frame" in said
    assert "not confirmed by the target</td><td>all that is seen through sphere2 &gt; sphere1" in said


def test_correlated_numbers_are_no_fault_where_the_map_is_known():
    """The plain alarm stays for what the frames do not know, and for a map that depends on it."""
    together = Weakness(("near.z", "far.z"), "near.z and far.z are strongly correlated", together=True)
    alone = Weakness(("near.n",), "near.n: known no better than before")

    def found(sigma_px):
        plane = np.full((2, 2, 2), sigma_px)
        return Calibration(None, SimpleNamespace(sigma_px=plane, behind_glass=np.eye(2) > 0), {}, {}, [], [], 1.0)

    said = "at most 0.0027 px in the map: near.z and far.z are strongly correlated"
    assert found(0.0027).weakness_sentence(together) == said
    assert found(0.3).weakness_sentence(together) == f"not determined: {together.sentence}"
    assert found(0.0027).weakness_sentence(alone) == f"not determined: {alone.sentence}"
