"""What is printed of results says what a reader takes it for."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from ground.terminal import console
from piv.preprocessing.image_figures import ImageFigures
from rtpiv.analysis.report.tables import image_table
from rtpiv.verbs.show import show_mean, show_through
from tests.correction.small_scenes import small_scene
from tests.rtpiv.analysis.series.test_split_focus import SHAPE, mean_of


def shown(mean, capsys):
    show_mean(console(), mean, Path("mean.html"))
    return " ".join(capsys.readouterr().out.split())


def test_a_jet_is_not_reported_by_the_median_of_a_plane_at_rest(capsys):
    """One column of four flows, at 1 m/s: the median over the plane is that of air at rest."""
    speed = np.zeros((*SHAPE, 2))
    speed[:, 1, 1] = 1.0
    said = shown(mean_of(speed, 0.001, 0), capsys)
    assert "where it flows: speed above half of 1 m/s, 3 of 12 places" in said
    row = said[said.index("mean [m/s]") :].split("│")
    assert abs(float(row[1])) < 0.01
    assert abs(float(row[2]) - 1.0) < 0.01
    assert "12 of 12 places" in shown(mean_of(0.3, 0.001, 0), capsys)


def test_pairs_that_are_not_in_a_mean_are_named_once_with_the_reason(capsys):
    lost = tuple((f"flow_{number:06d}", "its frame A is damaged") for number in (3, 4))
    mean = replace(mean_of(0.3, 0.001, 0), left_out=lost)
    said = shown(mean, capsys)
    assert "2 are left out" in said
    assert "flow_000003, flow_000004 (2 pairs) are left out: its frame A is damaged" in said
    show_mean(console(), mean, None, {"flow_000003": "its frame A is damaged"})  # as the series has said
    said = capsys.readouterr().out
    assert "flow_000003" not in said
    assert "flow_000004 is left out" in said


def test_noise_that_is_not_seen_is_no_infinite_ratio():
    bins = np.zeros(256, np.int64), np.zeros(257)
    for ratio, text in ((np.inf, "no noise seen"), (np.nan, "-"), (12.34, "12.3")):
        (row,) = image_table({"A": ImageFigures(0.02, 2.5, 2.5, ratio, 40.0, 0.0, 0.0, *bins, 100, 0)}, 255.0).rows
        assert row[3] == text


def test_verbs_of_vectors_say_what_is_seen_through_glass(capsys):
    show_through(console(), small_scene("two_spheres_500"))
    assert capsys.readouterr().out.startswith("through glass: ")
    show_through(console(), small_scene("two_spheres_500").bare())
    assert capsys.readouterr().out == ""
