"""Numbers in the wrong unit: what no lab can be is refused, what few labs are is asked about by name."""

import random
import re

import pytest
import yaml

from daq.errors import RunUsageError
from rtpiv.command_line.cli import DONE, USAGE, main
from rtpiv.verbs.check import check_files
from rtpiv.verbs.init import GivenLab, init
from tests.loops import loop_over
from tracer.errors import SceneError

DRAWN = 24  # slips of one file
FACTORS = (10.0, 0.1, 1000.0, 0.001)
SCENE = """\
wavelength_nm: 532.0
camera:
  f_mm: 60.0
  L_mm: 500.0
  pixel_pitch_um: 11.0
  sensor_px: [2016, 2016]
  principal_px: [1007.5, 1007.5]
  position_mm: [0.0, 0.0, 500.0]
  look_at_mm: [0.0, 0.0, 0.0]
  lens: {k1: 0.01}
  f_number: 22.0
  focus_mm: 450.0
bodies:
  - {name: near, kind: sphere, centre_mm: [4.0, -5.0, 26.0], radius_mm: 25.0, material: {n: 1.53}}
  - {name: far, kind: sphere, centre_mm: [4.0, -5.0, 77.0], radius_mm: 25.0, material: {n: 1.49},
     core: {radius_mm: 24.0, material: air}}
  - {name: rest, kind: rod, start_mm: [0.0, -40.0, 10.0], end_mm: [0.0, -60.0, 10.0], radius_mm: 4.0}
sheet: {z_mm: 0.8, sigma_mm: 0.05, thickness_mm: 1.0}
"""
LABS = {  # none of them like ours
    "microscope": {
        "camera": {"f_mm": 20.0, "L_mm": 25.0, "pixel_pitch_um": 6.5, "sensor_px": [2048, 2048]},
        "bodies": [(0.0, 0.0, 0.8, 0.75, 1.47)],
    },
    "vessel of two metres": {
        "camera": {"f_mm": 35.0, "L_mm": 3200.0, "pixel_pitch_um": 5.5, "sensor_px": [4872, 3248]},
        "bodies": [(0.0, 0.0, 400.0, 390.0, 1.33), (-700.0, 0.0, 300.0, 250.0, 1.34)],
    },
    "balls of a millimetre": {
        "camera": {"f_mm": 105.0, "L_mm": 210.0, "pixel_pitch_um": 3.45, "sensor_px": [2448, 2048]},
        "bodies": [(-1.0, 0.0, 0.55, 0.5, 1.52), (0.01, 0.0, 0.55, 0.5, 1.52), (1.02, 0.0, 0.55, 0.5, 1.52)],
    },
    "29 megapixels": {
        "camera": {"f_mm": 100.0, "L_mm": 900.0, "pixel_pitch_um": 5.5, "sensor_px": [6576, 4384]},
        "bodies": [(-60.0, 10.0, 61.0, 60.0, 1.47), (70.0, 0.0, 45.0, 44.0, 1.49)],
    },
    "line camera": {
        "camera": {"f_mm": 105.0, "L_mm": 700.0, "pixel_pitch_um": 5.0, "sensor_px": [8192, 96]},
        "bodies": [(0.0, 0.0, 41.0, 40.0, 1.49)],
    },
    "camera of a telephone, seen askew": {
        "camera": {"f_mm": 4.4, "L_mm": 260.0, "pixel_pitch_um": 1.55, "sensor_px": [4032, 3024],
                   "position_mm": [120.0, -40.0, 240.0], "look_at_mm": [0.0, 0.0, 0.0]},
        "bodies": [(0.0, 0.0, 46.0, 45.0, 1.33)],
    },
}  # fmt: skip


DUMPER = getattr(yaml, "CSafeDumper", yaml.SafeDumper)  # a tenth of the time where libyaml is there


def numbers_in(tree, place=()):
    """Place and value of every number that a slip would change."""
    if isinstance(tree, dict | list):
        for part, inner in tree.items() if isinstance(tree, dict) else enumerate(tree):
            yield from numbers_in(inner, (*place, part))
    elif isinstance(tree, int | float) and not isinstance(tree, bool) and tree:
        yield place, tree


def text_with(tree, place, value):
    """The file with another value at one place."""
    inner = tree
    for part in place[:-1]:
        inner = inner[part]
    before, inner[place[-1]] = inner[place[-1]], value
    plain = yaml.dump(tree, Dumper=DUMPER)
    text = re.sub(r"(\d)e([-+])", r"\1.0e\2", re.sub(r"(\.\d+)e", r"\1.e", plain)).replace(".e", "e")
    inner[place[-1]] = before
    return text


def verdict(path, bench=None):
    """Refusal or questions about a file, as one text; empty if it passes without a word."""
    try:
        (found,) = check_files([path], bench)
    except RunUsageError as error:
        return str(error)
    return "\n".join(found.questions)


def scene_with(tmp_path, old, new, text=SCENE):
    assert old in text
    path = tmp_path / "scene.yaml"
    path.write_text(text.replace(old, new, 1))
    return path


@pytest.fixture
def untraced(monkeypatch):
    """Files are read and asked about; what is seen through the glass, which asks nothing, is not computed."""
    monkeypatch.setattr("rtpiv.verbs.check._describe_view", lambda scene: "")


@loop_over(
    "old, new, words",
    [
        ("f_mm: 60.0", "f_mm: 0.06", r"f_mm: should be 0.1 or more, not 0.06; m for mm\?"),
        ("pixel_pitch_um: 11.0", "pixel_pitch_um: 5500.0", r"should be 1000 or less, not 5500.0; nm for um\?"),
        ("pixel_pitch_um: 11.0", "pixel_pitch_um: 0.0055", r"should be 0.1 or more, not 0.0055; mm for um\?"),
        ("principal_px: [1007.5", "principal_px: [1.0e+9", "principal_px.1: should be 100000 or less"),
        ("k1: 0.01", "k1: 1.0e+6", "lens terms move a corner of the picture by .* %, which no lens does"),
        ("focus_mm: 450.0", "focus_mm: 45.0", r"never in focus at focus_mm 45; cm for mm\?"),
        ("focus_mm: 450.0", "focus_mm: 0.45", r"never in focus at focus_mm 0.45; m for mm\?"),
        ("sensor_px: [2016, 2016]", "sensor_px: [1, 1]", "a sensor of 1 x 1 px shows nothing"),
        ("centre_mm: [4.0, -5.0, 77.0]", "centre_mm: [1.0e+9, -5.0, 77.0]", r"than 100000 mm.*um for mm\?"),
        ("wavelength_nm: 532.0", "wavelength_nm: 0.532", r"should be 300 or more, not 0.532; um for nm\?"),
    ],
)  # fmt: skip
def test_what_no_lab_can_be_is_refused_with_the_slip(tmp_path, capsys, old, new, words):
    path = scene_with(tmp_path, old, new)
    assert main(["check", str(path)]) == USAGE
    said = capsys.readouterr().err
    assert re.search(words, said), said
    assert re.search(r"scene.yaml:\d+: ", said)


@loop_over(
    "old, new, words",
    [
        ("radius_mm: 25.0, material: {n: 1.53}", "radius_mm: 0.02, material: {n: 1.53}", "near: is it .* diam"),
        ("centre_mm: [4.0, -5.0, 77.0]", "centre_mm: [23000.0, -5.0, 77.0]", r"far: is it outside .*um for mm\?"),
        ("sheet: {z_mm: 0.8", "sheet: {z_mm: 25.0", r"is z_mm 25 right, .* of what the camera sees\?"),
        ("pixel_pitch_um: 11.0", "pixel_pitch_um: 110.0", r"is 110 right\? Usual are 1.4 to 30; ten times too"),
        ("f_mm: 60.0", "f_mm: 6.0", "all bodies together fill .* focal length, the distance, the pixels"),
        ("k1: 0.01", "k1: 3.0", "do its terms move the corner of the picture by"),
        ("sensor_px: [2016, 2016]", "sensor_px: [2016, 20160]", "is a sensor of 2016 x 20160 px right"),
    ],
)  # fmt: skip
@pytest.mark.usefixtures("untraced")
def test_what_few_labs_are_is_asked_about_by_name(tmp_path, capsys, old, new, words):
    path = scene_with(tmp_path, old, new)
    assert main(["check", str(path)]) == DONE
    said = capsys.readouterr().out
    assert re.search(words, said), said


def test_trace_asks_as_well(tmp_path, capsys, monkeypatch):
    def refuse(scene):
        raise SceneError("traced")

    monkeypatch.setattr("rtpiv.verbs.trace.build_ray_map", refuse)  # it asks before it computes
    path = tmp_path / "scene.yaml"
    camera = "camera: {focal_px: 400.0, sensor_px: [96, 96], position_mm: [0.0, 0.0, 500.0]}\n"
    ball = "{name: near, kind: sphere, centre_mm: [0.0, 0.0, 25.0], radius_mm: 0.02, material: {n: 1.5}}"
    path.write_text(f"{camera}bodies: [{ball}]\n")
    assert main(["trace", str(path), "-o", str(tmp_path / "trace"), "--no-pictures"]) == USAGE
    assert "near: is it" in capsys.readouterr().out


@pytest.mark.usefixtures("untraced")
def test_the_scene_itself_is_asked_nothing(tmp_path):
    assert verdict(scene_with(tmp_path, "f_mm", "f_mm")) == ""


@pytest.mark.parametrize("name", LABS)
def test_labs_that_resemble_none_of_ours_pass(tmp_path, name):
    lab = LABS[name]
    kinds = ("kind", "sphere"), ("name", "")
    bodies = [
        {**dict(kinds), "name": f"b{n}", "centre_mm": [x, y, z], "radius_mm": r, "material": {"n": index}}
        for n, (x, y, z, r, index) in enumerate(lab["bodies"])
    ]
    path = tmp_path / "scene.yaml"
    path.write_text(yaml.safe_dump({"camera": lab["camera"], "bodies": bodies}))
    (found,) = check_files([path])
    shape = "line" in name  # a sensor of such a shape is asked about, and passes
    assert all("sensor_px" in asked for asked in found.questions) if shape else found.questions == ()


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    folder = tmp_path_factory.mktemp("lab")
    init(folder, GivenLab(balls=5, arrangement="pyramid"))
    (folder / "scene.yaml").write_text((folder / "scene.yaml").read_text())
    return folder


@pytest.mark.slow
@pytest.mark.usefixtures("untraced")
def test_slips_of_every_number_of_a_scene_are_seen(tmp_path):
    """Of all numbers and four factors; silent may be only what some lab is."""
    tree = yaml.safe_load(SCENE)
    silent = []
    path = tmp_path / "scene.yaml"
    for place, value in numbers_in(tree):
        for factor in FACTORS:
            wrong = round(value * factor) if isinstance(value, int) else value * factor
            path.write_text(text_with(tree, place, wrong))
            if not verdict(path):
                silent.append((place[-1] if isinstance(place[-1], str) else place[-2], factor))
    can_be = {("centre_mm", 10.0), ("centre_mm", 0.1), ("centre_mm", 0.001), ("f_number", 0.1), ("radius_mm", 0.1),
              ("radius_mm", 0.001), ("k1", 10.0), ("k1", 0.1), ("k1", 0.001), ("z_mm", 0.1), ("z_mm", 0.001),
              ("sigma_mm", 10.0), ("sigma_mm", 0.1), ("sigma_mm", 0.001), ("start_mm", 10.0), ("start_mm", 0.1),
              ("start_mm", 1000.0), ("start_mm", 0.001), ("end_mm", 10.0), ("end_mm", 0.1), ("end_mm", 1000.0),
              ("end_mm", 0.001)}  # fmt: skip
    assert set(silent) <= can_be


@pytest.mark.parametrize("name", ["bench", "bench-flow", "plan-target", "plan-shift", "plan-flow"])
@pytest.mark.slow
def test_drawn_slips_of_benches_and_plans_are_seen(lab, tmp_path, name):
    """Most of them; the rest are labs that there are: another speed, another time of settling, fewer frames."""
    for file in lab.glob("*.yaml"):
        (tmp_path / file.name).write_bytes(file.read_bytes())
    path, rng = tmp_path / f"{name}.yaml", random.Random(name)
    tree, bench = (
        yaml.safe_load(path.read_text()),
        tmp_path / ("bench-flow.yaml" if "flow" in name else "bench.yaml"),
    )
    free = {"seed", "settle_s", "acceleration_mm_s2", "speed_mm_s", "backlash_um", "lead_error_um", "buffers",
            "frames", "pairs", "chunk", "repeats", "dt_us", "along", "timeout_s", "ExposureTime"}  # fmt: skip
    drawn = [(place, value) for place, value in numbers_in(tree) if not free & {*place}]
    cases = [
        (place, value, factor)
        for place, value in drawn
        for factor in (FACTORS[::2] if name.startswith("plan") else FACTORS)
    ]
    silent = []
    for place, value, factor in rng.sample(cases, min(DRAWN, len(cases))):
        wrong = round(value * factor) if isinstance(value, int) else value * factor
        path.write_text(text_with(tree, place, wrong))
        if wrong not in (0, value) and not verdict(path, bench if name.startswith("plan") else None):
            silent.append((place, factor))
    assert len(silent) <= 0.35 * min(DRAWN, len(cases)), silent


@loop_over(
    "old, new, words",
    [
        ("distance_mm: 0.5, speed_mm_s: 2.0}", "distance_mm: 0.5, speed_mm_s: 2000.0}",
         "the approach at 2000 mm/s is faster than the axis"),
        ("backend: harvesters", "backend: harvester", "unknown; use one of .*did you mean 'harvesters'"),
        ("backend: harvesters", 'backend: "no_such_package.m:Camera"', "names no_such_package"),
        ("out_mm: {glass_y: -", "out_mm: {glass_y: -99", r"glass.out_mm: glass_y -\d+ mm is outside its"),
    ],
)  # fmt: skip
def test_what_the_dry_run_refuses_check_refuses(lab, tmp_path, capsys, old, new, words):
    for file in lab.glob("*.yaml"):
        (tmp_path / file.name).write_bytes(file.read_bytes())
    path = tmp_path / "bench.yaml"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    assert main(["check", str(path)]) == USAGE
    said = capsys.readouterr().err
    assert re.search(words, said), said
    plan = str(tmp_path / "plan-target.yaml")
    assert main(["acquire", plan, "--bench", str(path), "--dry-run"]) != DONE
    assert re.search(words, capsys.readouterr().err)


def test_objects_that_count_steps_are_refused_by_check_too(lab, tmp_path, capsys):
    """A driver that speaks mm has no steps_per_mm: the stage says so before any plan is looked at."""
    for file in lab.glob("*.yaml"):
        (tmp_path / file.name).write_bytes(file.read_bytes())
    path = tmp_path / "bench.yaml"
    tree = yaml.safe_load(path.read_text())
    tree["stages"]["axes"]["target_x"]["steps_per_mm"] = 1000.0  # on a controller that counts in mm
    path.write_text(yaml.safe_dump(tree))
    assert main(["check", str(path)]) == USAGE
    assert "remove steps_per_mm of" in capsys.readouterr().err


def test_init_refuses_pixels_that_no_camera_has(tmp_path, capsys):
    assert main(["init", str(tmp_path / "lab"), "--pixel-pitch-um", "0.0055"]) == USAGE
    assert "mm for um?" in capsys.readouterr().err
