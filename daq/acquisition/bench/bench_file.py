"""bench.yaml: the hardware that stands together, and the scene it looks at.

    name: glass-bench
    scene: two_spheres_500.yaml          # beside this file; true where every axis stands at its scene_at_mm
    scene_at_mm: {rail_z: 500.0}         # position of an axis at which the scene file holds; 0 if not named
    stages: {...}                        # see stages.config
    glass:                               # where the glass stands when it is in and out of the picture
      out_mm: {glass_y: -120.0}
      retract_mm: {glass_z: 5.0}         # goes there first, comes back from there last
    camera:
      backend: harvesters
      options: {cti: /opt/vendor/gentl.cti, serial: "1234"}
      settings: {PixelFormat: Mono12p, ExposureTime: 2000.0, TriggerMode: "On", TriggerSource: Software}
      timeout_s: 5.0
    devices: {...}                       # any more, each with its `kind` and what that needs
    target: {square_mm: 2.5, disc_mm: 1.0}
    keep_out: {...}                      # see stages.keep_out; without it nothing but limits is judged
    simulation: {bench: "sim.bench:SimulatedBench", ...}   # what --simulate puts in place of the hardware

Which axis moves which element, and along which world direction, is said by the axes themselves (`carries`,
`along`): `camera`, `glass` and `target` are known.  So the position of every element, and with it the scene, is a
function of the axis positions.
"""

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from daq.acquisition.bench.bench_table import GLASS, Bench, BenchTable, Device
from daq.acquisition.bench.kinds import kind_of
from daq.errors import RunUsageError
from ground.config import Document, open_document, validate
from ground.errors import ConfigError, Problem
from tracer.scene_file import load_scene

T = TypeVar("T")


def load_bench(path: Path | str) -> Bench:
    """Read a bench file and the scene it names.

    Raises
    ------
    ConfigError
        Everything wrong with either, with file and line.
    """
    document = open_document(path)
    wrong: list[ConfigError] = []
    table = _tried(lambda: validate(document, BenchTable), wrong)
    tree = document.tree if isinstance(document.tree, dict) else {}
    named = table.scene if table is not None else tree.get("scene")
    scene = None
    if isinstance(named, str) and named:
        scene = _tried(lambda: load_scene(document.path.parent / named), wrong)
    if table is not None and scene is not None and table.glass is None and table.axes_of(GLASS) and scene.bodies:
        text = "axes carry the glass, so say glass.out_mm"
        wrong.append(ConfigError(document.path, [Problem(document.line(("stages",)), text)]))
    walls = [body.name for body in scene.bodies if body.room is not None] if scene is not None else []
    if walls:  # keep-out, the witness and runs move all bodies with the glass, and know a wall by a ball around it
        named_walls = " and ".join(map(repr, walls))
        text = (
            f"the scene has {named_walls}: no bench knows yet where windows and tubes stand; leave them out of its"
        )
        text += " scene, and correct its frames with a scene file that has them"
        wrong.append(ConfigError(document.path, [Problem(document.line(("scene",)), text)]))
    devices = table.devices if table is not None else tree.get("devices")
    sections = devices.items() if isinstance(devices, dict) else ()
    more = {
        name: _tried(partial(_device, document, name, section), wrong)
        for name, section in sections
        if isinstance(name, str) and isinstance(section, dict)
    }
    if table is None or scene is None or wrong:
        raise ConfigError.joined(wrong)
    return Bench(document.path.resolve(), document, table, scene, {name: d for name, d in more.items() if d})


def _tried(build: Callable[[], T], wrong: list[ConfigError]) -> T | None:
    """Build something; None if its file is wrong, with what is wrong added."""
    try:
        return build()
    except ConfigError as error:
        wrong.append(error)
        return None


def _device(document: Document, name: str, section: Mapping[str, Any]) -> Device:
    """Check the section of a device by what its kind says."""
    place = ("devices", name)
    if not isinstance(section.get("kind"), str):
        raise ConfigError(document.path, [Problem(document.line(place), f"{'.'.join(place)}: say its kind")])
    try:
        model = kind_of(section["kind"]).section
    except RunUsageError as error:
        raise ConfigError(document.path, [Problem(document.line((*place, "kind")), str(error))]) from None
    own = {key: value for key, value in section.items() if key != "kind"}
    lines = {at[2:]: line for at, line in document.lines.items() if at[:2] == place}
    return Device(section["kind"], validate(Document(document.path, own, lines), model))
