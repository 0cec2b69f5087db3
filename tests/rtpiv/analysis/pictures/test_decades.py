"""Logarithmic axes have plain numbers: formulas are off, so matplotlib's own labels would be their source text."""

from correction.fit.judge.result import FitStep
from rtpiv.analysis.pictures import calibration


def test_the_convergence_of_a_fit_has_plain_numbers(tmp_path, monkeypatch):
    drawn = []
    monkeypatch.setattr(calibration, "save_picture", lambda figure, *_: drawn.append(figure))
    calibration.draw_convergence(tmp_path / "convergence.png", [FitStep("a", 9, 0.1), FitStep("b", 9, 0.01)])
    drawn[0].draw_without_rendering()
    said = {label.get_text() for label in drawn[0].axes[0].get_xticklabels(which="both")}
    assert {"0.01", "0.1"} <= said
    assert not any("$" in text for text in said)
