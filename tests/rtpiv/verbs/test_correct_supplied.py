"""The main job on the supplied frames: the corrected target lies on the regular grid."""

import json

import numpy as np
import pytest
import tifffile

from rtpiv.verbs.correct import correct
from tests.supplied import supplied
from tracer.scene.scene_file import dump_scene


# One full-size case is enough for every day; the others take as long and say the same.
@pytest.fixture(scope="module", params=["two_spheres", pytest.param("one_sphere", marks=pytest.mark.slow)])
def frames(request):
    return supplied(request.param)


@pytest.mark.slow
def test_true_scene_puts_every_corner_on_the_grid(frames, tmp_path):
    """Corners within 0.10 px rms of the regular grid over the recovered region, glass taken by itself too."""
    (tmp_path / "scene.yaml").write_text(dump_scene(frames.truth))
    done = correct(frames.path("target_glass"), str(tmp_path / "scene.yaml"), tmp_path / "out", check_target=True)
    errors = done.errors
    assert done.frames == (tmp_path / "out" / "target_glass.tif",)
    everywhere, glass = errors[0].regions["all"], errors[0].regions["behind glass"]
    assert max(everywhere.rms_px) <= 0.10
    assert max(glass.rms_px) <= 0.10
    assert max(np.abs(glass.bias_px)) <= 0.03
    assert everywhere.found >= 0.95 * everywhere.expected
    assert glass.found >= 0.90 * glass.expected
    with tifffile.TiffFile(tmp_path / "out" / "target_glass.tif") as file:
        about = json.loads(file.pages[0].description)
        assert file.pages[0].dtype == np.uint16
    assert about["scene_hash"] == frames.truth.content_hash()
    assert about["px_per_mm"] == pytest.approx(frames.truth.camera.focal_px / frames.truth.camera.position_mm[2])
