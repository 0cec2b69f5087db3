"""The main job on frames that nobody supplied: other scenes and glass, a tilted camera, another renderer."""

import pytest

from rtpiv.verbs.correct import correct
from sim.demo.frames import make_frames


@pytest.mark.slow
@pytest.mark.parametrize("name", ["three_spheres_500", "pair_off_axis", "pyramid_500", "tilted"])
def test_true_scene_puts_every_corner_on_the_grid(name, tmp_path):
    """Corners within 0.10 px rms of the regular grid over the recovered region, behind glass by itself too."""
    frames = make_frames(name, 2016, 11, tmp_path / "frames", stack=False)
    (errors,) = correct(
        [frames.path("target_glass")], tmp_path / "frames" / "truth.yaml", tmp_path / "out", check_target=True
    ).errors
    everywhere, glass = errors.regions["all"], errors.regions["behind glass"]
    assert max(everywhere.rms_px) <= 0.10
    assert max(glass.rms_px) <= 0.10
    assert everywhere.found >= 0.95 * everywhere.expected
    assert glass.found >= 0.90 * glass.expected
