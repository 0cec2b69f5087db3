"""Values with arrays say in one line what they are."""

import importlib
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ground.short_repr import short_repr
from tests.loops import loop_over
from tracer.scene.scene_file import load_scene
from tracer.strategies.ray_map import build_ray_map

VALUES = ("tracer.strategies.ray_map:RayMap", "tracer.scene.scene:Scene", "tracer.strategies.trace:TraceResult",
"correction.maps.dewarp:Dewarp",
          "correction.maps.correction_map:CorrectionMap", "piv.correlation.vector_field:VectorField",
          "correction.fit.judge.result:SceneFit", "correction.fit.seen.measurement:TargetFrame",
          "correction.fitted.map_sigma:MapSigma", "correction.evaluate.target_error:TargetError",
          "rtpiv.analysis.pairs.evaluation:Evaluation", "rtpiv.analysis.series.mean_flow:MeanFlow",
          "rtpiv.analysis.series.split_focus:JoinedMean", "rtpiv.analysis.focus:FocusScan")  # fmt: skip


@short_repr
@dataclass
class Inner:
    a: float


@short_repr
@dataclass
class Outer:
    big: np.ndarray
    inner: Inner
    several: list
    words: str
    few: tuple = (1.0, 1.0 / 3.0)
    hidden: int = field(default=5, repr=False)


def test_one_line():
    said = repr(Outer(np.zeros((3, 4), np.float32), Inner(1.0), list(range(100)), "x" * 500))
    assert said.startswith("Outer(big=<float32 3 x 4>, inner=Inner(...), several=<list of 100>, words='xxx")
    assert said.endswith("few=(1, 0.333333))")
    assert len(said) < 250
    assert repr(Inner(1.0 / 3.0)) == "Inner(a=0.333333)"


@loop_over("name", VALUES)
def test_what_people_get_is_short(name):
    module, _, kind = name.partition(":")
    assert "short_repr" in getattr(importlib.import_module(module), kind).__repr__.__qualname__


def test_a_real_one():
    scene = load_scene(Path(__file__).resolve().parents[2] / "examples" / "demo" / "scene.yaml")
    assert len(repr(scene)) < 300
    assert "Sphere(...)" in repr(scene)
    small = scene.with_camera(scene.camera)
    assert "\n" not in repr(build_ray_map(small))
    assert len(repr(build_ray_map(small))) < 500
