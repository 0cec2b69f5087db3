"""The chapter on what stood before the camera: blur where the scene says an aperture, where the light sheet is."""

from dataclasses import replace

import pytest

from rtpiv.analysis.report import pair
from rtpiv.analysis.report.page import Page
from rtpiv.analysis.report.pair import light_sheet_line, scene_chapter
from tests.correction.small_scenes import small_scene
from tests.slow_cases import slow
from tracer.light_sheet import LightSheet
from tracer.pupil import Pupil


@pytest.mark.draws
@pytest.mark.parametrize(
    ("f_number", "bodies", "drawn"), [slow(None, True, False), (11.0, True, True), slow(11.0, False, False)]
)
def test_blur_is_drawn_where_an_aperture_looks_through_glass(tmp_path, f_number, bodies, drawn):
    scene = small_scene("two_spheres_500", 96)
    if f_number is not None:
        scene = scene.with_camera(replace(scene.camera, pupil=Pupil(30.0 / f_number, 500.0)))
    page = Page("a", "b")
    scene_chapter(page, scene if bodies else scene.with_bodies(()))
    page.write(tmp_path / "page.html")
    text = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert ("aperture shows each point" in text) == drawn
    assert (tmp_path / "blur.png").exists() == drawn


@pytest.mark.draws
def test_a_scene_is_drawn_once_for_all_pages_and_before_them(tmp_path, monkeypatch):
    """As the process that draws has nothing else to do then; with another name of a ball it is drawn anew."""
    scene, drawn = small_scene("two_spheres_500", 96), []
    other = scene.with_bodies([replace(body, name=f"{body.name} b") for body in scene.bodies])
    assert other.content_hash() == scene.content_hash()
    plain = pair.scene_figure
    monkeypatch.setattr(pair, "scene_figure", lambda scene: drawn.append(scene) or plain(scene))
    pair.draw_scene_of_page(scene, False)
    for number, each in enumerate((scene, scene, other)):
        page = Page("a", "b")
        scene_chapter(page, each)
        (folder := tmp_path / str(number)).mkdir()
        page.write(folder / "page.html")
    assert drawn == [scene, other]
    files = [(tmp_path / str(number) / "scene.svg").read_bytes() for number in range(3)]
    assert files[0] == files[1] != files[2]


@pytest.mark.parametrize(
    ("sheet", "bodies", "said"),
    [
        (None, True, "does not say where the light sheet is"),
        (None, False, "+- 0.5 mm"),
        (LightSheet(0.2, sigma_mm=0.05), True, "light sheet at z = +0.200 +- 0.05 mm"),
    ],
)
def test_it_is_said_where_particles_were_taken_to_lie(tmp_path, sheet, bodies, said):
    scene = replace(small_scene("two_spheres_500", 96), sheet=sheet)
    page = Page("a", "b")
    light_sheet_line(page, scene if bodies else scene.with_bodies(()))
    page.write(tmp_path / "page.html")
    text = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert said in text
    assert ("find it with rtpiv sheet" in text.lower()) == (sheet is None)
