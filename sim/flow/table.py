"""The `flow` part of a bench file's `simulation` section: which flow, and how it is lit.

simulation:
  flow:
    field: jet                          # uniform shear vortex jet channel turbulent_channel between_balls
    parameters: {exit_mm_s: 1940.0}     # of the field, by the names in sim/flow/fields.py and jet.py
    turbulence: {length_mm: 8.0, memory_s: 0.02}     # none: a steady flow
    sheet: {thickness_mm: 1.0, offset_mm: 0.0, energies: [1.0, 1.0], apart_mm: 0.0}
    seeding: {per_px: 0.03, spread: 0.35}
    reflections: {sheet_counts: 40.0, glint_counts: 900.0}
    particle_counts: 70.0
"""

from dataclasses import asdict, fields
from typing import Annotated, Any, Literal, cast

import yaml
from pydantic import Field, TypeAdapter, model_validator

from ground.config import Table
from sim.flow.between_balls import BetweenBalls
from sim.flow.fields import Flow, LaminarChannel, Shear, TurbulentChannel, Uniform, Vortex
from sim.flow.images import FlowCamera
from sim.flow.jet import Jet
from sim.flow.modes import RandomModes
from sim.flow.particles import LightSheet, Seeding
from sim.flow.reflections import Reflections
from sim.renderer.render import Aperture
from tracer.errors import SceneError
from tracer.scene.scene import Scene

FIELDS: dict[str, Any] = {
    "uniform": Uniform,
    "shear": Shear,
    "vortex": Vortex,
    "jet": Jet,
    "channel": LaminarChannel,
    "turbulent_channel": TurbulentChannel,
    "between_balls": BetweenBalls,
}
PARTS = {"sheet": LightSheet, "seeding": Seeding, "reflections": Reflections}


class FlowTable(Table):
    """Flow of the simulated bench."""

    field: Literal["uniform", "shear", "vortex", "jet", "channel", "turbulent_channel", "between_balls"] = "jet"
    parameters: dict[str, Any] = Field(default_factory=dict)
    turbulence: dict[str, Any] | None = Field(default_factory=lambda: {"length_mm": 8.0})
    sheet: dict[str, Any] = Field(default_factory=dict)
    seeding: dict[str, Any] = Field(default_factory=dict)
    reflections: dict[str, Any] = Field(default_factory=dict)
    particle_counts: Annotated[float, Field(ge=0.0, le=65535.0)] = 70.0

    @model_validator(mode="after")
    def _can_be_made(self) -> "FlowTable":
        try:
            self.flow(0)
            self._parts()
        except SceneError as error:
            raise ValueError(str(error)) from None
        return self

    def flow(self, seed: int, scene: Scene | None = None) -> Flow:
        """The flow; `seed` is that of its turbulence unless the section says one, `scene` has its balls.

        Raises
        ------
        SceneError
            A number is wrong.
        """
        base = _parse_part("parameters", FIELDS[self.field], self.parameters)
        if isinstance(base, BetweenBalls) and scene is not None:
            base = base.around(scene)
        if self.turbulence is None:
            return Flow(base)
        return Flow(base, _parse_part("turbulence", RandomModes, {"seed": seed, **self.turbulence}))

    def as_text(self, seed: int, scene: Scene | None = None) -> str:
        """Every number as YAML that this table reads again, defaults written out."""
        flow = self.flow(seed, scene)
        numbers = {
            "field": self.field,
            "parameters": asdict(cast("Any", flow.base)),
            "turbulence": None if flow.modes is None else asdict(flow.modes),
            **{name: asdict(part) for name, part in self._parts().items()},
            "particle_counts": self.particle_counts,
        }
        return yaml.safe_dump(_plain(numbers), sort_keys=False)

    def camera(self, scene: Scene, seed: int, aperture: Aperture | None) -> FlowCamera:
        """A camera that looks at the flow through a scene."""
        counts = self.particle_counts
        return FlowCamera(
            scene, self.flow(seed, scene), **self._parts(), particle_counts=counts, aperture=aperture, seed=seed
        )

    def _parts(self) -> dict[str, Any]:
        """Sheet, seeding and reflections; SceneError if a number is wrong."""
        return {name: _parse_part(name, kind, getattr(self, name)) for name, kind in PARTS.items()}


def _plain(value: Any) -> Any:  # noqa: ANN401 - a tree of numbers
    """Tuples as lists."""
    if isinstance(value, dict):
        return {key: _plain(part) for key, part in value.items()}
    return [_plain(part) for part in value] if isinstance(value, list | tuple) else value


def _parse_part(name: str, kind: Any, values: dict[str, Any]) -> Any:  # noqa: ANN401 - any of the classes above
    """One of the dataclasses above from plain numbers.

    Raises
    ------
    SceneError
        A name is unknown, or a value of the wrong type.
    """
    known = [field.name for field in fields(kind)]
    if unknown := sorted(set(values) - set(known)):
        raise SceneError(f"{name}: {unknown[0]} is not known; there are {', '.join(known)}")
    try:
        return TypeAdapter(kind).validate_python(values)
    except ValueError as error:
        first = str(error).splitlines()[1:3]
        raise SceneError(f"{name}: {' '.join(line.strip() for line in first)}") from None
