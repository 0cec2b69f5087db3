"""What moves on the investigation plane asks for no new map, in a run or in the next one."""

from dataclasses import replace

from correction.fitted import prepared
from daq.pipeline.corrections import Corrections
from daq.plans.steps import CLEAR, Step
from tests.correction.small_scenes import small_scene


def test_nothing_is_traced_again_when_only_the_pattern_moves(tmp_path, monkeypatch):
    traced = []
    build = prepared.build_ray_map
    monkeypatch.setattr(prepared, "build_ray_map", lambda scene: traced.append(scene) or build(scene))
    scene = small_scene("two_spheres_500", 96)
    here = Step(0, "here", (("target_x", 0.0),), 0.0, 0, 1, "glass", "particles", True, None)
    there = replace(here, index=1, tag="there", positions_mm=(("target_x", 3.7),), reference=0)
    first = Corrections(scene, maps=tmp_path)
    assert first.of(here) is first.of(there)
    assert len(traced) == 1
    first.of(replace(here, view=CLEAR))  # another scene: the bodies are gone
    assert len(traced) == 2
    Corrections(scene, maps=tmp_path).of(there)
    assert len(traced) == 2
    Corrections(scene).of(there)  # maps are not stored: traced again
    assert len(traced) == 3
    assert first.of(replace(there, on_plane=False)) is None
