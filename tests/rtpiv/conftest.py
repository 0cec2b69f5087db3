"""What tests of verbs and of the analysis share."""

import pytest


@pytest.fixture
def no_mean_page(monkeypatch):
    """No page with its pictures, two thirds of what a small mean takes, where a test looks at numbers alone."""
    monkeypatch.setattr("rtpiv.analysis.report.mean.write_mean_page", lambda *given: None)
