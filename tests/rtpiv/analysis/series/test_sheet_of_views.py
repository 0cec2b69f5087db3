"""Disparity of two views whose frames show the same particles at nearly the same places."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from piv.correlation.settings import PivSettings
from rtpiv.analysis.series import sheet_of_views
from tests.piv.conftest import draw

SIDE, PARTICLES = 192, 2000


@pytest.mark.parametrize("apart_px", [(0.0, 0.0), (1.0, -0.8)])
def test_views_that_agree_are_no_static_light(monkeypatch, apart_px):
    """At 41 degrees a sheet of 1 mm spreads particles by 2 px about one place: all was taken for static light."""
    rng = np.random.default_rng(5)
    u, v = rng.uniform(0.0, SIDE, (2, PARTICLES))
    light, height = rng.uniform(200.0, 600.0, PARTICLES), rng.uniform(-2.0, 2.0, PARTICLES)
    frames = {
        name: draw((SIDE, SIDE), u + share * (height + apart_px[0]), v - share * apart_px[1], 2.4, light)
        + rng.normal(40.0, 3.0, (SIDE, SIDE))
        for name, share in (("left", -0.5), ("right", 0.5))
    }
    corrector = SimpleNamespace(recovered=np.ones((SIDE, SIDE), bool))
    monkeypatch.setattr(sheet_of_views, "correction_of", lambda *_: SimpleNamespace(corrector=corrector))
    monkeypatch.setattr(sheet_of_views, "_frames", lambda series: iter([frames[series.out.name]]))
    left, right = (
        SimpleNamespace(out=Path(name), method=SimpleNamespace(settings=PivSettings())) for name in frames
    )
    ((uv, sigma),) = sheet_of_views._disparities(left, right, 1)
    inner = uv[2:-2, 2:-2]
    assert np.isfinite(inner).mean() > 0.9
    assert np.nanmean(inner, axis=(0, 1)) == pytest.approx(apart_px, abs=0.25)  # by the heights of the particles
    assert np.nanmedian(sigma) < 0.4
