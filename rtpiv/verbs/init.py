"""`rtpiv init`: write scene, bench and plan files for a new lab."""

import os
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from daq.atomic_write import write_text
from daq.errors import RunUsageError
from ground.plain_words import quantity
from ground.terminal import console
from rtpiv.analysis.report.table import Table
from rtpiv.options.numbers import Count, Positive
from rtpiv.templates.arrangement import (
    ARRANGEMENTS,
    LAYERED,
    TUBE_PLANE,
    Arrangement,
    layers_mm,
    most_balls,
    usual,
)
from rtpiv.templates.files import bench_text, board_text, flow_plan, scene_text, shift_plan, target_plan
from rtpiv.templates.lab import Lab
from rtpiv.templates.room import room_of
from rtpiv.verbs.check import check_files
from rtpiv.verbs.paths import Named
from rtpiv.verbs.results import results_in
from rtpiv.verbs.schema import write_schemas

BED_GAP_MM = 5.0  # between a bed and the board behind it
SHOWN_ARRANGEMENTS = 8  # other arrangements
SAID = {"behind": ", one behind the other", "beside": " beside each other"}
FILES = ("scene.yaml", "bench.yaml", "plan-target.yaml", "plan-shift.yaml", "bench-flow.yaml", "plan-flow.yaml")
BOARD = "board.yaml"  # where the lab has no board of its own
YES, NO = ("yes", "y"), ("no", "n")
Words = dict[str, Any]


@dataclass(frozen=True)
class Question:
    """Question about one number or name of `Lab`."""

    key: str
    text: str
    read: Callable[[str], Any]
    usual: str = ""  # field of the default, where it has another name


def _sensor(text: str) -> tuple[int, int]:
    width, height = text.lower().replace("x", " ").replace(",", " ").split()
    return int(width), int(height)


def _yes(text: str) -> bool:
    word = text.lower()
    if word not in YES + NO:
        raise ValueError(text)
    return word in YES


QUESTIONS = (
    Question("sensor_px", "camera: width and height of its frames in px", _sensor),
    Question("pixel_pitch_um", "camera: size of a pixel in um (data sheet)", float),
    Question("distance_mm", "from the lens to the plane (light sheet, target) in mm", float),
    Question("arrangement", f"balls: how they stand ({', '.join(ARRANGEMENTS)})", str),
    Question("balls", "balls: how many", int),
    Question("ball_mm", "balls: diameter in mm", float),
    Question("glass", "balls: of what (acrylic, borosilicate, BK7, soda-lime, fused-silica ...)", str),
    Question("gap_mm", "gap between the lowest ball and the plane in mm", float),
    Question("support_mm", "rods that hold them from below: diameter in mm, 0 for none", float),
    Question("lens_mm", "lens: focal length in mm", float),
    Question("square_mm", "board: side of its squares in mm, as measured", float, "board_mm"),
    Question("wavelength_nm", "light: wavelength in nm", float),
    Question("by_hand", "stages: without motors, all moved by hand (yes, no)", _yes),
)


@dataclass(frozen=True)
class GivenLab:
    """Description of the lab; anything else is asked or has a default.

    Parameters
    ----------
    name : str, optional
        Name of the bench: letters, digits, underscores (default lab).
    sensor_px : (int, int), optional
        Width and height of the camera's frames (default 1280 1024).
    pixel_pitch_um : float, optional
        Size of a pixel (default 4.8).
    lens_mm : float, optional
        Focal length (default: the longest that sees all balls).
    distance_mm : float, optional
        From the lens to the plane (default 500).
    arrangement : str, optional
        Arrangement: one behind the other (behind, row), beside each other (beside, side), ...; sc, bcc,
        hcp: packed beds; tube: a packed tube (default: behind; triangle of 3, pyramid of 4 or 5).
    balls : int, optional
        Number of balls (default 2).
    ball_mm : float or sequence of float, optional
        Diameter of a ball, or of each behind or beside each other (default 40).
    glass : str or sequence of str, optional
        Of the balls, or of each behind or beside each other: acrylic, BK7, borosilicate ... (default acrylic).
    gap_mm : float, optional
        From the plane to the lowest ball (default: where they show most).
    support_mm : float, optional
        Diameter of steel rods that hold the balls (default 0).
    square_mm : float, optional
        Squares of the board (default: the smallest standard size that this camera resolves well).
    wavelength_nm : float, optional
        Wavelength of the light (default 532).
    turn_deg : float, optional
        Viewing angle of the camera about the y axis (default 0).
    layers : int, optional
        Layers of a bed (bcc, sc, hcp, tube; default bcc) with the light sheet in it and the board behind it.
    plane : float, optional
        Layer of the sheet, counted from the top: 1 (default) through the centres of the top layer, 1.5 between it
        and the next.
    by_hand : bool
        No motors: micrometers and a ruler, moved and read by a person.
    """

    name: str | None = None
    sensor_px: tuple[Count, Count] | None = None
    pixel_pitch_um: Positive | None = None
    lens_mm: Positive | None = None
    distance_mm: Positive | None = None
    arrangement: Arrangement | None = None
    balls: Count | None = None
    ball_mm: Positive | Sequence[Positive] | None = None
    glass: str | Sequence[str] | None = None
    gap_mm: float | None = None
    support_mm: float | None = None
    square_mm: Positive | None = None
    wavelength_nm: Positive | None = None
    turn_deg: float | None = None
    layers: Count | None = None
    plane: Positive | None = None
    by_hand: bool = False

    @property
    def words(self) -> Words:
        """Given values, as arguments of `Lab`."""
        words = asdict(self)
        sensor, ball_mm, glass = words.pop("sensor_px"), words.pop("ball_mm"), words.pop("glass")
        words |= _each("ball_mm", "sizes_mm", ball_mm, max) | _each("glass", "glasses", glass, _first)
        words["sensor_px"] = None if sensor is None else (sensor[0], sensor[1])
        words["by_hand"] = self.by_hand or None  # not given, so it may be asked
        return {key: value for key, value in words.items() if value is not None}


def init(
    folder: Named = Path(),
    /,
    lab: GivenLab = GivenLab(),
    ask: bool = True,
    overwrite: bool = False,
) -> list[Path]:
    """Write scene, benches and plans for a lab, with comments; each is checked as `rtpiv check` does.

    Parameters
    ----------
    folder : path
        Output folder.
    lab : GivenLab
        Description of the lab.
    ask : bool
        Ask at the terminal for what is not given; use defaults instead of prompting.
    overwrite : bool
        Overwrite these files.

    Returns
    -------
    list of Path
        The files.

    Raises
    ------
    RunUsageError
        Numbers that cannot be, or files that are there already; nothing is written.
    DiskError
        The folder cannot be written to.
    """
    folder = Path(folder)
    given = _with_layers(lab.words)
    _refuse_existing(folder, overwrite)
    if ask and sys.stdin is not None and sys.stdin.isatty():
        console().print("Enter takes what stands in brackets; Ctrl-C ends, and nothing is written.")
        given = _answers(given)
    full = _lab(given, placed=True)
    room = room_of(full)
    flow = bench_text(full, room, laser=True), flow_plan(full)
    each = scene_text(full), bench_text(full, room), target_plan(full, room), shift_plan(full), *flow
    texts = dict(zip(FILES, each, strict=True)) | ({} if full.square_mm else {BOARD: board_text(full)})
    with tempfile.TemporaryDirectory(prefix="rtpiv-") as trial:
        _write(Path(trial), texts)
        _check(Path(trial))
    with results_in(folder):
        _refuse_existing(folder, overwrite)  # another process may have written
        _write(folder, texts)
        write_schemas(folder / "schemas")
    _print(full, folder, "lens_mm" not in given)
    return [folder / file for file in texts]


def _with_layers(given: Words) -> Words:
    """Return the description of a bed by its layers with what follows from them."""
    if "layers" not in given:
        if "plane" in given:
            raise RunUsageError("plane counts the layers of a bed; give --layers too")
        return given
    if "balls" in given or any(isinstance(given.get(key), tuple) for key in ("sizes_mm", "glasses")):
        raise RunUsageError("layers say how many balls a bed has, all alike; leave --balls out")
    shape = given.get("arrangement", "bcc")
    count = len(layers_mm(shape, given["layers"], 1.0)[0]) if shape in LAYERED else 1
    usual_plane = {"plane": TUBE_PLANE} if shape == "tube" else {}
    return {"gap_mm": BED_GAP_MM} | usual_plane | given | {"arrangement": shape, "balls": count}


def _first(several: Sequence[Any]) -> Any:  # noqa: ANN401 - of any kind
    return several[0]


def _each(one: str, each: str, given: Any, chosen: Callable[[Sequence[Any]], Any]) -> Words:  # noqa: ANN401
    """Return a value shared by all balls, or one for each and the representative one."""
    if given is None or isinstance(given, str | float | int):
        return {one: given}
    return {one: chosen(given), each: tuple(given) if len(given) > 1 else None}


def _lab(given: Words, placed: bool = False) -> Lab:
    """Return the lab with defaults; if `placed`, balls without a gap stand where they show most."""
    several = given.get("sizes_mm") or given.get("glasses") or ()
    count, shape = usual(
        given.get("balls", len(several) or None), given.get("arrangement", "behind" if several else None)
    )
    lab = Lab(**(given | {"balls": count, "arrangement": shape}))
    if said := (lab if "lens_mm" in given else lab.with_usual_lens()).too_small:
        raise RunUsageError(said)
    if placed and "gap_mm" not in given:
        from rtpiv.analysis.views.arranged import best_gap

        if (best := best_gap(lab, "lens_mm" not in given)) is not None:
            return best.lab
    return lab if "lens_mm" in given else lab.with_usual_lens()


def _write(folder: Path, texts: Words) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for file, text in texts.items():
        write_text(folder / file, text)


def _check(folder: Path) -> None:
    """Check that the plans can be executed on their benches, before anything is written to the lab."""
    try:
        check_files([folder / "plan-target.yaml", folder / "plan-shift.yaml"], folder / "bench.yaml")
        check_files([folder / "plan-flow.yaml"], folder / "bench-flow.yaml")
    except RunUsageError as error:
        said = str(error).splitlines()[0].replace(f"{folder}{os.sep}", "")
        raise RunUsageError(f"these numbers make no bench that works, so nothing is written: {said}") from None


def _refuse_existing(folder: Path, overwrite: bool) -> None:
    if folder.exists() and not folder.is_dir():
        raise RunUsageError("is a file", place=folder, cure="give a folder")
    there = [file for file in (*FILES, BOARD) if (folder / file).exists()]
    if there and not overwrite:
        raise RunUsageError(
            f"{', '.join(there)} is there already", place=folder, cure="give another folder, or --overwrite"
        )


def _answers(given: Words) -> Words:
    """Ask for what is not given, one question after the other."""
    answers = dict(given)
    for question in QUESTIONS:
        if question.key in answers:
            continue
        known = _lab(answers, placed=question.key == "gap_mm")
        if question.key == "balls" and len(most_balls(known.arrangement)) == 1:
            continue
        usually = getattr(known, question.key)
        shown = _answer_text(getattr(known, question.usual or question.key))
        while question.key not in answers:
            said = _line(f"{question.text} [{shown}]: ")
            try:
                value = question.read(said) if said else usually
                _lab(answers | {question.key: value})
            except RunUsageError as error:
                print(f"  {error}")
            except ValueError:
                print(f"  {said!r} cannot be read; enter for example {shown}")
            else:
                answers[question.key] = value
    return answers


def _answer_text(usually: Any) -> str:  # noqa: ANN401 - of any question
    """Return an answer as it would be typed."""
    if isinstance(usually, bool):
        return (YES if usually else NO)[0]
    return " x ".join(map(str, usually)) if isinstance(usually, tuple) else f"{usually}"


def _line(prompt: str) -> str:
    try:
        return input(prompt).strip()
    except EOFError:
        print(file=sys.stderr)
        raise KeyboardInterrupt from None


def _print(lab: Lab, folder: Path, lens: bool) -> None:
    from rtpiv.analysis.gaps import Gaps, share_of_scene
    from tracer.scene.scene_file import load_scene

    screen = console()
    width, height = lab.field_mm
    span = " x ".join(f"{side:.0f}" for side in lab.span_mm)
    sizes, glasses = (", ".join(dict.fromkeys(each)) for each in ([f"{d:g}" for d in lab.each_mm], lab.each_glass))
    stand = SAID.get(lab.arrangement, f" ({lab.arrangement})")
    balls = f"{quantity(lab.balls, 'ball')} of {sizes} mm {glasses}{stand if lab.balls > 1 else ''}"
    field = f"{width:.0f} x {height:.0f} mm of the plane, {lab.px_per_mm:.1f} px/mm"
    screen.print(f"{balls}, {span} mm; a lens of {lab.lens_mm:g} mm sees {field}", soft_wrap=True)
    board = f"board: squares of {lab.board_mm:.4g} mm, {lab.board_mm * lab.px_per_mm:.0f} px"
    where = f"{BOARD}; print it with rtpiv setup target {BOARD}, or give the squares of yours with --square-mm"
    where = "square_mm of target in both bench files" if lab.square_mm else where
    screen.print(f"{board} ({where})", soft_wrap=True)
    if (shown := share_of_scene(load_scene(folder / "scene.yaml"))) is not None:
        screen.print(shown.sentence, style="bold")
        if not isinstance(shown, Gaps):
            if warning := _too_little(lab, shown.share):
                screen.print(warning, style="bold red", soft_wrap=True)
            _print_others(lab, shown.share, lens)
    screen.print(
        f"{', '.join(FILES)} are in {folder}, and pass `rtpiv check`. Next, in that folder:", soft_wrap=True
    )
    for words in (*FIRST, *(IN_BED if lab.layers else BEFORE_PLANE)):
        screen.print(f"  {words}", soft_wrap=True)
    screen.print("Comments at the top of each file tell what to edit for real hardware; then omit --simulate.")


def _too_little(lab: Lab, share: float) -> str:
    """Return advice for a lab that shows little; "" where it shows enough."""
    from rtpiv.analysis.views.arranged import LITTLE

    if share >= LITTLE:
        return ""
    wider = max(span / field for span, field in zip(lab.span_mm, lab.field_mm, strict=True))
    if wider <= 1.0:
        return "This lab shows little through its glass; what shows more is listed here."
    balls, field = (" x ".join(f"{side:.0f}" for side in sides) for sides in (lab.span_mm, lab.field_mm))
    return (
        f"This lab shows little through its glass: its balls are {balls} mm and the camera sees {field} mm;"
        f" --lens-mm {lab.lens_mm / wider:.2g} or --distance-mm {lab.distance_mm * wider:.2g} shows them whole."
    )


def _print_others(lab: Lab, share: float, lens: bool) -> None:
    """Print the views of other arrangements of such balls, first these balls elsewhere if that shows more."""
    from rtpiv.analysis.through_glass import percent
    from rtpiv.analysis.views.arranged import WORTH, best_gap, others

    found = others(lab, lens)
    if (best := best_gap(lab, lens)) is not None and best.share > WORTH * share:
        found.insert(0, best)
    if not found:
        return
    rows = [
        (str(lab.balls), lab.arrangement, f"{lab.gap_mm:g}", f"{lab.lens_mm:g}", percent(share))
        for lab, share in ((one.lab, one.share) for one in found[:SHOWN_ARRANGEMENTS])
    ]
    columns = ("--balls", "--arrangement", "--gap-mm", "--lens-mm", "through glass")
    title = "other arrangements of such balls, each where it shows most"
    table = Table(title, columns, rows, left=(1,)).__rich__()
    table.box = None
    console().print(table)


FIRST = (
    "rtpiv trace scene.yaml -o trace",
    "rtpiv acquire plan-target.yaml --bench bench.yaml --simulate --home",
    "rtpiv calibrate runs/*plan-target -o fit",
)
BEFORE_PLANE = (
    "rtpiv acquire plan-shift.yaml --bench bench.yaml --simulate --home --scene fit/scene.yaml",
    "rtpiv report runs/*plan-shift --scene fit/scene.yaml",
)
IN_BED = (  # a print does not fit between balls
    "rtpiv acquire plan-flow.yaml --bench bench-flow.yaml --simulate --home --scene fit/scene.yaml",
    "rtpiv mean runs/*plan-flow --scene fit/scene.yaml",
)
