"""`rtpiv sheet` from frames on the disk to a scene file that has the sheet, and what it refuses."""

import json
from dataclasses import replace

import numpy as np
import pytest

from correction.light_sheet import disparities, self_calibration
from piv.errors import PairError
from piv.files.frame_file import write_frame
from rtpiv.analysis import light_sheet
from rtpiv.analysis.light_sheet import flow_frames
from rtpiv.verbs.sheet import sheet
from tests.correction.light_sheet.particle_frames import camera, frames_of
from tracer.light_sheet import LightSheet
from tracer.scene.fit_section import FitTable
from tracer.scene.scene_file import dump_scene, load_priors, load_scene


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    """Ten pairs on the disk, A, B, A, B ..., and the scene."""
    folder = tmp_path_factory.mktemp("flow")
    flow_camera = camera("three_spheres_500", 400, -0.25)
    known = replace(flow_camera.scene, sheet=LightSheet(0.1, sigma_mm=0.4))
    (folder / "scene.yaml").write_text(dump_scene(known, FitTable(n=0.004)))
    (folder / "fit.npz").write_bytes(b"a fit")
    paths = []
    for number, pair in enumerate(frames_of(flow_camera, 10)()):
        for name, frame in zip("ab", pair, strict=True):
            paths.append(folder / f"{number:03d}{name}.tif")
            write_frame(paths[-1], frame.astype(np.uint16), 1.0, {})
    return folder, paths


@pytest.mark.slow
@pytest.mark.draws
def test_the_scene_that_is_written_has_the_sheet(lab, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(self_calibration, "MOST_PLACES", 4000)
    monkeypatch.setattr(disparities, "MODELLED", 300)
    monkeypatch.setattr(disparities, "LEAST_MODELLED", 12)
    folder, paths = lab
    out = tmp_path / "sheet"
    found = sheet(paths, folder / "scene.yaml", out)
    assert abs(found.sheet.z_mm + 0.25) < 4.0 * found.sheet.sigma_mm < 0.3
    before, after = (load_scene(where / "scene.yaml") for where in (folder, out))
    assert after.content_hash() == before.content_hash()
    assert after.sheet == found.sheet
    assert load_priors(out / "scene.yaml") == FitTable(n=0.004)
    assert (out / "fit.npz").read_bytes() == b"a fit"
    assert (out / "sheet.png").stat().st_size > 10_000
    said = json.loads((out / "sheet.json").read_text())
    assert said["sheet"]["z_mm"] == found.sheet.z_mm
    assert said["known_before"]["z_mm"] == 0.1
    assert len(said["cells"]) == len(found.cells.kind)
    assert "places where particles are seen twice" in " ".join(capsys.readouterr().out.split())


@pytest.mark.slow
def test_what_shows_no_light_sheet_is_refused(lab, monkeypatch):
    folder, paths = lab
    scene = load_scene(folder / "scene.yaml")
    with pytest.raises(PairError, match="A, B, A, B"):
        flow_frames(paths[:3], scene)
    pairs = flow_frames(paths, scene).pairs
    assert flow_frames([folder / "%03da.tif"], scene).pairs == pairs
    assert flow_frames([folder], scene).pairs == pairs
    monkeypatch.setattr(light_sheet, "is_run", lambda path: True)
    pairs = [_Pair(measured_mm=(0.1, 0.0, 0.0))]
    monkeypatch.setattr(light_sheet, "pairs_of", lambda path: _Pairs(pairs))
    with pytest.raises(PairError, match="print on the target's stage"):
        flow_frames([folder], scene)
    pairs[:] = [_Pair(glass=False), _Pair(is_background=True)]
    with pytest.raises(PairError, match="without the glass"):
        flow_frames([folder], scene)


class _Pair:
    def __init__(self, glass=True, measured_mm=None, is_background=False):
        self.glass, self.measured_mm, self.is_background = glass, measured_mm, is_background


class _Pairs:
    def __init__(self, pairs):
        self.pairs = pairs
