"""scene.yaml: the camera, the glass and the light, as a person at the bench knows them.

    wavelength_nm: 532.0
    ambient: {n: 1.0}                    # or a named medium: air, vacuum; what is called air in bodies is this gas
    glasses:                             # optional, beside those of tracer.media: acrylic, BK7, borosilicate ...
      crown: {n: 1.53}
      own: {sellmeier: {b: [1.04, 0.23, 1.01], c_um2: [0.006, 0.02, 103.6]}}
      melt: {base: N-BK7, offset: 0.0012}  # measured: dispersion of N-BK7, n higher by 0.0012
    camera:
      f_mm: 60.0                         # lens focused on the plane from L_mm ...
      L_mm: 500.0
      # focal_px: 6198.3                 # ... or the principal distance in pixels
      pixel_pitch_um: 11.0
      sensor_px: [2016, 2016]            # width, height
      position_mm: [0.0, 0.0, 500.0]     # pinhole; default (0, 0, L_mm)
      look_at_mm: [0.0, 0.0, 0.0]        # default the origin; with roll_deg, or a full rotation instead
      lens: {k1: 0.0}                    # acquired -> ideal, see tracer.camera
      f_number: 22.0                     # with focus_mm, the distance in focus (default L_mm): blur and centroids
    bodies:
      - {name: front, kind: sphere, centre_mm: [0.0, 0.0, 25.0], radius_mm: 25.0, material: crown}
      - {name: hollow, kind: sphere, centre_mm: [0.0, 0.0, 75.0], radius_mm: 25.0, material: crown,
         core: {radius_mm: 24.0, material: air}}   # gas inside; a core may have a core itself
      - {name: support, kind: rod, start_mm: [0.0, -40.0, 10.0], end_mm: [0.0, -60.0, 10.0], radius_mm: 4.0}
    sheet: {z_mm: 0.2, sigma_mm: 0.05}   # optional: where particles are lit, see tracer.light_sheet
      # thickness_mm: 1.0                  # with it, where the light comes from: it is traced through the bodies
      # sources: [{from_deg: 180.0, width_mm: 120.0, profile: gaussian, fan_deg: 10.0}]
    masked:                              # optional: parts of the frame that no map may use, see tracer.masked
      - {why: unlisted body, outline_px: [[410, 300], [455, 310], [430, 352]]}
      - {why: unconfirmed, through: [front, hollow]}
      - {why: left out, outline_mm: [[-40, -30], [40, -30], [40, -25], [-40, -25]]}   # a wall, by hand
      - {why: left out, picture: mask.png}   # beside this file, as large as a frame; white is left out
    fit:                                 # optional: what a scene fit may change, see tracer.scene.fit_section
      spheres: {centre_mm: 1.0, radius_mm: 0.02}

What each section may hold stands in ``tracer.scene.scene_tables``.
"""

from collections.abc import Callable, Mapping
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import yaml

from ground.config import Document, Place, open_document, require_kind, validate
from ground.errors import ConfigError, Problem
from ground.terminal import say_once
from tracer.bodies import Body
from tracer.errors import SceneError
from tracer.light_sheet import LightSheet
from tracer.masked import MaskedPart
from tracer.media import MEDIA, THINNEST_LIQUID, VACUUM, Medium, medium_called
from tracer.medium_table import medium_entry, medium_of
from tracer.scene.fit_section import SHAPE_KEYS, FitSphereTable, FitTable
from tracer.scene.scene import Scene
from tracer.scene.scene_tables import SceneTable
from tracer.scene.touching import separate_touching
from tracer.scene.view import view_problems

T = TypeVar("T")
ANY_CAMERA: dict[str, Any] = {
    "focal_px": 1e3,
    "sensor_px": [2016, 2016],
    "position_mm": [0.0, 0.0, 9e4],
}  # above all


def scene_from(document: Document, table: SceneTable) -> Scene:
    """Build the scene of a checked file.

    Raises
    ------
    ConfigError
        The scene is impossible, or glass can never be seen; each problem with the line of what is at fault.
    """
    problems: list[Problem] = []
    media = MEDIA | _own_media(document, table, problems)
    bodies: list[Body] = []
    inside = media | _air_of_the_room(table, media)
    names = [body.name or f"{body.kind}{index + 1}" for index, body in enumerate(table.bodies)]
    for index, (name, entry) in enumerate(zip(names, table.bodies, strict=True)):
        try:
            bodies.append(entry.resolve_paths(document.path.parent).body(name, inside))
        except SceneError as error:
            for part, text in error.problems:
                at: tuple[str | int, ...] = ("bodies", index, *(part or "material").split("."))
                problems.append(Problem(document.line(at), text))
    ambient = _attempt(lambda: medium_of(table.ambient, media), document.line(("ambient",)), problems)
    camera = _attempt(table.camera.camera, document.line(("camera",)), problems)
    sheet = None if table.sheet is None else _attempt(table.sheet.light_sheet, document.line(("sheet",)), problems)
    masked: list[MaskedPart] = []
    for index, left in enumerate(table.masked):
        sensor_px = None if camera is None else camera.sensor_px
        described = partial(left.parts, document.path.parent, sensor_px)
        masked += _attempt(described, document.line(("masked", index)), problems) or ()
    scene = None
    if camera is not None:
        try:
            placed, steps_mm = separate_touching(bodies, table.fit)
            scene = Scene(camera, placed, table.wavelength_nm, ambient or VACUUM, sheet, masked=tuple(masked))
            if text := scene.unseen_sheet:
                problems.append(Problem(document.line(("sheet",)), f"sheet: {text}"))
            if steps_mm:
                each = ", ".join(f"{name} by {step:.2g} mm" for name, step in steps_mm.items())
                say_once(
                    f"{document.path}: overlapping balls were moved apart within the sigma of their"
                    f" centres: {each}"
                )
        except SceneError as error:
            for name, text in error.problems:
                at = ("bodies", names.index(name)) if name in names else ("ambient",)
                problems.append(Problem(document.line(at), text))
        for name, text in view_problems(camera, bodies):
            at = ("bodies", names.index(name)) if name else ("camera",)
            problems.append(Problem(document.line(at), text))
    if scene is None or problems:
        raise ConfigError(document.path, problems)
    return scene


def _attempt(build: Callable[[], T], line: int, problems: list[Problem]) -> T | None:
    """Build something; None if that cannot be, with what is wrong added to `problems`."""
    try:
        return build()
    except SceneError as error:
        problems += [Problem(line, text) for _, text in error.problems]
        return None


def _air_of_the_room(table: SceneTable, media: dict[str, Medium]) -> dict[str, Medium]:
    """Medium that `air` means in a body: the gas of the room, if that is one."""
    try:
        room = medium_of(table.ambient, media)
        gas = room.n(table.wavelength_nm) < THINNEST_LIQUID
    except SceneError:  # said where the ambient is read
        return {}
    return {"air": room} if gas else {}


def _own_media(document: Document, table: SceneTable, problems: list[Problem]) -> dict[str, Medium]:
    """Glasses that the file itself describes; what cannot be is added to `problems`."""
    media: dict[str, Medium] = {}
    for name, glass in table.glasses.items():
        try:
            media[name] = glass.medium(name)
        except SceneError as error:
            problems.append(Problem(document.line(("glasses", name)), str(error)))
    return media


def load_priors(path: Path | str) -> FitTable:
    """Read the ``fit:`` section of a scene file: what a scene fit may change (see `tracer.scene.fit_section`).

    Raises
    ------
    ConfigError
        The file is wrong, or the section names a body or glass that the scene does not have, or no number of it.
    """
    document = open_document(path)
    table = validate(document, SceneTable)
    scene = scene_from(document, table)
    known_keys = {
        sphere.name: {key for key in FitSphereTable.model_fields if sphere.may_be_uneven or key not in SHAPE_KEYS}
        for sphere in scene.spheres
    }
    for body in scene.others:
        if numbers := body.numbers(scene.wavelength_nm):
            known_keys[body.name] = {number.known for number in numbers}
    glasses = {_glass_of(name, table): sigma for name, sigma in table.fit.glasses.items()}
    problems = [
        Problem(document.line(("fit", part, name)), f"fit.{part}: there is no {what} {name!r} in this scene")
        for part, what, given, known in (
            ("named", "sphere, window or tube", table.fit.named, known_keys),
            ("glasses", "glass", glasses, MEDIA.keys() | table.glasses.keys()),
        )
        for name in given
        if name not in known
    ]
    problems += [
        Problem(
            document.line(("fit", "named", name, key)),
            f"fit.named.{name}: {key} is no number that frames tell of {name!r}; of that they tell"
            f" {', '.join(sorted(known_keys[name] - {'n'}))}",
        )
        for name, own in table.fit.named.items()
        for key in own.model_fields_set
        if name in known_keys and key not in known_keys[name]
    ]
    if problems:
        raise ConfigError(document.path, problems)
    return table.fit.model_copy(update={"glasses": glasses})


def _glass_of(name: str, table: SceneTable) -> str:
    """Name under which the scene has a glass that the fit section calls so; as it is if there is none."""
    found = None if name in table.glasses else medium_called(name)
    return name if found is None else found.name


def load_scene(path: Path | str) -> Scene:
    """Read a scene file.

    Parameters
    ----------
    path : path
        scene.yaml.

    Raises
    ------
    ConfigError
        Everything wrong with it, with file and line.
    """
    document = open_document(path)
    require_kind(document, SceneTable.model_fields)
    try:
        table = validate(document, SceneTable)
    except ConfigError as error:
        raise ConfigError(document.path, [*error.problems, *_further_problems(document, error)]) from None
    return scene_from(document, table)


def _further_problems(document: Document, error: ConfigError) -> list[Problem]:
    """Further problems of a file: of its valid bodies, as its camera sees them if that is valid.

    Overlaps and unknown glass are reported with the first misspelt key, not after it.
    """
    if not isinstance(document.tree, dict):
        return []
    wrong = {problem.line for problem in error.problems}
    tree, lines = dict(document.tree), {}
    for key in [key for key in tree if key != "bodies" and _lines_of(document, (key,)) & wrong]:
        if key == "glasses":
            return []  # a body made of them would be reported as unknown
        del tree[key]
    entries = tree.get("bodies", [])
    sound = [] if not isinstance(entries, list) else [
        index for index in range(len(entries)) if not _lines_of(document, ("bodies", index)) & wrong
    ]  # fmt: skip
    tree |= {"bodies": [entries[index] for index in sound], "camera": tree.get("camera", ANY_CAMERA)}
    for place, line in document.lines.items():
        if place[:1] != ("bodies",) or len(place) < 2:
            lines[place] = line
        elif place[1] in sound:
            lines[("bodies", sound.index(int(place[1])), *place[2:])] = line
    rest = Document(document.path, tree, lines)
    try:
        scene_from(rest, validate(rest, SceneTable))
    except ConfigError as further:
        known = {(problem.line, problem.text) for problem in error.problems}
        return [problem for problem in further.problems if (problem.line, problem.text) not in known]
    return []


def _lines_of(document: Document, start: Place) -> set[int]:
    return {line for place, line in document.lines.items() if place[: len(start)] == start}


def dump_scene(scene: Scene, fit: FitTable | None = None) -> str:
    """Return the scene as the text of a scene file; `load_scene` of it gives the same content hash.

    Parameters
    ----------
    scene : Scene
    fit : FitTable, optional
        What a fit may change, to stand beside it; glasses of its own that it names keep their names.
    """
    camera = scene.camera
    media = {medium.name: medium for body in scene.bodies for _, medium in body.media}
    named = [name for name in (fit.glasses if fit else ()) if name in MEDIA or name in media]
    own = {name: medium_entry(media[name]) for name in named if name not in MEDIA}
    section = {} if fit is None else fit.model_dump(mode="json", exclude_defaults=True, exclude={"glasses"})
    section |= {"glasses": {name: fit.glasses[name] for name in named}} if fit and named else {}
    pupil = camera.pupil
    aperture = {} if pupil is None else {"pupil_mm": 2.0 * pupil.radius_mm, "focus_mm": pupil.focus_mm}
    tree = {
        "wavelength_nm": scene.wavelength_nm,
        "ambient": medium_entry(scene.ambient),
        "camera": {
            "focal_px": camera.focal_px,
            "sensor_px": list(camera.sensor_px),
            "principal_px": list(camera.principal_px),
            "position_mm": list(camera.position_mm),
            "rotation": [list(row) for row in (camera.mirrored() if camera.is_mirrored else camera).rotation],
            **({"mirrored": True} if camera.is_mirrored else {}),
            "lens": dict(zip(("k1", "k2", "k3", "p1", "p2"), camera.lens.terms().tolist(), strict=True)),
            **aperture,
        },
        **({"glasses": own} if own else {}),
        "bodies": [_by_name(body.section(), own) for body in scene.bodies],
        **({} if scene.sheet is None else {"sheet": _sheet_section(scene.sheet)}),
        **({"masked": [_section_of_mask(part) for part in scene.masked]} if scene.masked else {}),
        **({"fit": section} if section else {}),
    }
    return yaml.safe_dump(tree, sort_keys=False, default_flow_style=None, width=110)


def _by_name(section: Mapping[str, Any], own: Mapping[str, Any]) -> dict[str, Any]:
    """A section in which glasses that have a name of their own stand by it."""
    names = {key: name for key, value in section.items() for name, text in own.items() if text == value}
    inner = {k: _by_name(v, own) for k, v in section.items() if isinstance(v, dict)}
    return {**section, **inner, **names}


def _sheet_section(sheet: LightSheet) -> dict[str, Any]:
    """The light sheet as a scene file has it."""
    said = asdict(sheet) | {"correlation": list(sheet.correlation), "sources": None}
    if sheet.sources:
        said["sources"] = [asdict(source) for source in sheet.sources]
        for source in said["sources"]:
            source["profile"] = "gaussian" if source.pop("gaussian") else "uniform"
    return {key: value for key, value in said.items() if value is not None}


def _section_of_mask(part: MaskedPart) -> dict[str, Any]:
    """A masked part as a scene file has it."""
    if part.through:
        return {"why": part.why, "through": list(part.through)}
    where, outline = ("outline_px", part.outline_px) if part.outline_px else ("outline_mm", part.outline_mm)
    return {"why": part.why, where: [list(point) for point in outline]}
