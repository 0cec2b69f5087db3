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
    devices: {...}                       # any more, each with its `kind` and what that needs; a further camera
                                         # has a `scene` of its own
    target: {square_mm: 2.5, disc_mm: 1.0}  # or {board: board.yaml}, written by `rtpiv setup target`
    keep_out: {...}                      # see daq.bench.keep_out; without it nothing but limits is judged
    simulation: {bench: "sim.bench:SimulatedBench", ...}   # what --simulate puts in place of the hardware

Which axis moves which element, and along which world direction, is said by the axes themselves (`carries`,
`along`): `camera`, `glass` and `target` are known.  So the position of every element, and with it the scene, is a
function of the axis positions.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from correction.errors import BoardError
from correction.target.board_file import PrintedBoard, read_board
from daq.bench.bench_table import Bench, BenchTable, CameraSection, Device, NamedCameraSection
from daq.bench.elements import CAMERA, GLASS
from daq.bench.kinds import kind_of
from daq.bench.read_out import image_of
from daq.errors import RunUsageError, SettingRefused
from ground.config import Document, open_document, validate
from ground.errors import ConfigError, Problem
from tracer.bodies import CONTACT_TOL_MM
from tracer.scene.scene import Scene
from tracer.scene.scene_file import load_scene

T = TypeVar("T")


def load_bench(path: Path | str) -> Bench:
    """Read a bench file and the scene it names.

    Parameters
    ----------
    path : path
        bench.yaml.

    Returns
    -------
    Bench
        What stands on the bench; nothing is opened.

    Raises
    ------
    ConfigError
        Everything wrong with either, with file and line.
    """
    document = open_document(path)
    wrong: list[ConfigError] = []
    table = _try_build(lambda: validate(document, BenchTable), wrong)
    tree = document.tree if isinstance(document.tree, dict) else {}
    named = table.scene if table is not None else tree.get("scene")
    scene = None
    if isinstance(named, str) and named:
        scene = _try_build(lambda: load_scene(document.path.parent / named), wrong)
    glass = [body for body in scene.bodies if not body.stays] if scene is not None else []
    if table is not None and table.glass is None and table.axes_of(GLASS) and glass:
        text = "axes carry the glass, so say glass.out_mm"
        wrong.append(ConfigError(document.path, [Problem(document.line(("stages",)), text)]))
    if table is not None and scene is not None:
        parted = [Problem(document.line(("scene",)), text) for text in _wall_conflicts(table, scene)]
        wrong += [ConfigError(document.path, parted)] if parted else []
    devices = table.devices if table is not None else tree.get("devices")
    sections = devices.items() if isinstance(devices, dict) else ()
    more = {
        name: _try_build(partial(_device, document, name, section), wrong)
        for name, section in sections
        if isinstance(name, str) and isinstance(section, dict)
    }
    found = {name: device for name, device in more.items() if device}
    seen: dict[str, Scene] = {}
    for name, device in found.items():
        section = device.section
        if not isinstance(section, NamedCameraSection):
            continue
        if section.scene is not None or section.scene_shows == "sensor":
            file = None if section.scene is None else document.path.parent / section.scene
            own = scene if file is None else _try_build(partial(load_scene, file), wrong)
            own = None if own is None else _scene_of_image(document, ("devices", name), section, own, wrong)
            seen |= {} if own is None else {name: own}
    if table is not None and scene is not None:
        scene = _scene_of_image(document, ("camera",), table.camera, scene, wrong)
    printed = None if table is None else _read_printed_board(document, table, wrong)
    if table is None or scene is None or wrong:
        raise ConfigError.merge(wrong)
    return Bench(document.path.resolve(), document, table, scene, found, seen, printed)


def _read_printed_board(document: Document, table: BenchTable, wrong: list[ConfigError]) -> PrintedBoard | None:
    """The board file that a bench names."""
    named = table.target.board
    printed = None if named is None else _try_build(lambda: read_board(document.path.parent / named), wrong)
    if printed is not None:
        try:
            printed.board()
        except BoardError as error:
            wrong.append(ConfigError(document.path, [Problem(document.line(("target", "board")), str(error))]))
    return printed


def _scene_of_image(
    document: Document, place: tuple[str, ...], section: CameraSection, scene: Scene, wrong: list[ConfigError]
) -> Scene | None:
    """The scene as the image shows it that a camera sends."""
    if section.scene_shows == "image":
        return scene
    try:
        return replace(scene, camera=image_of(scene.camera, section.settings))
    except SettingRefused as error:
        wrong.append(ConfigError(document.path, [Problem(document.line((*place, "settings")), str(error))]))
        return None


def _wall_conflicts(table: BenchTable, scene: Scene) -> Iterator[str]:
    """Yield a problem for each axis that would drive something through the wall of a tube."""
    walls = {body.name: body for body in scene.bodies if body.room is not None and body.room.surrounds}
    for wall in walls.values():
        room = wall.room
        assert room is not None
        inside = [body for body in scene.bodies if body.name != wall.name]
        held: dict[str, str] = {
            body.name: body.carried for body in inside if room.gaps_mm(*body.outline_mm)[1] >= -CONTACT_TOL_MM
        }
        if room.gaps_mm(np.array([scene.camera.position_mm]), 0.0)[1] >= 0.0:
            held["the camera"] = CAMERA
        for name, carrier in held.items():
            axes = [*table.axes_of(carrier), *table.axes_of(wall.carried)]
            if carrier != wall.carried and axes:
                yield (
                    f"{wall.kind} {wall.name!r} is carried by the {wall.carried}, {name} in it by the {carrier}:"
                    f" {axes[0]} would drive one through the other; say carried_by: {carrier} of {wall.name!r} in"
                    " the scene file"
                )
                break


def _try_build(build: Callable[[], T], wrong: list[ConfigError]) -> T | None:
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
        raise ConfigError(document.path, [Problem(document.line(place), f"{'.'.join(place)}: set its kind")])
    try:
        model = kind_of(section["kind"]).section
    except RunUsageError as error:
        raise ConfigError(document.path, [Problem(document.line((*place, "kind")), str(error))]) from None
    own = {key: value for key, value in section.items() if key != "kind"}
    return Device(section["kind"], validate(replace(document.inside(*place), tree=own), model))
