"""`rtpiv init`: files that work for every arrangement, from options or from answers; nothing where nothing can."""

import itertools
import json
import math
import os
import pty
import re
import subprocess
import sys
from dataclasses import replace

import jsonschema
import pytest
import yaml

from correction.maps.correction_map import build_correction_map
from daq.bench.bench_file import load_bench
from daq.errors import RunUsageError
from ground.config import load_yaml
from rtpiv.analysis.through_glass import coarse_map, percent, through_glass
from rtpiv.command_line.cli import DONE, USAGE, main
from rtpiv.templates.arrangement import centres_mm, rods_mm, usual
from rtpiv.templates.files import bench_text, scene_of, shift_plan, target_plan
from rtpiv.templates.lab import LENSES_MM, Lab
from rtpiv.templates.room import room_of
from rtpiv.verbs.acquire import acquire
from rtpiv.verbs.calibrate import calibrate
from rtpiv.verbs.check import FileCheck, check
from rtpiv.verbs.init import BOARD, FILES, QUESTIONS, GivenLab, init
from rtpiv.verbs.target import target
from tests.loops import loop_over
from tests.slow_cases import slow
from tracer.light_table import LightTable
from tracer.scene.scene_file import load_priors, load_scene
from tracer.strategies.ray_map import build_ray_map

LABS = {
    "one ball": {"balls": 1},
    "two in a row": {"balls": 2},
    "three in a row": {"balls": 3, "arrangement": "row"},
    "two beside each other": {"balls": 2, "arrangement": "side"},
    "triangle on rods": {"balls": 3, "support_mm": 8.0, "sensor_px": (1024, 1024), "pixel_pitch_um": 5.5},
    "pyramid of five": {"arrangement": "pyramid", "glass": "borosilicate"},
    "pyramid of four that touches": {"balls": 4, "gap_mm": 0.0, "support_mm": 6.0},
    "body-centred bed": {"arrangement": "bcc", "ball_mm": 20.0, "glass": "BK7"},
    "closest packing on rods": {"arrangement": "hcp", "balls": 17, "ball_mm": 16.0, "support_mm": 3.0},
    "near": {"balls": 1, "distance_mm": 250.0, "ball_mm": 20.0, "glass": "BK7"},
    "far": {"balls": 2, "distance_mm": 1500.0, "lens_mm": 105.0, "ball_mm": 100.0, "wavelength_nm": 527.0},
    "five megapixels": {"balls": 1, "sensor_px": (2448, 2048), "pixel_pitch_um": 3.45},
    "by hand": {"balls": 2, "by_hand": True},
    "by hand, on the plane": {"balls": 3, "gap_mm": 0.0, "by_hand": True},
    "by hand, body-centred bed": {"arrangement": "bcc", "ball_mm": 20.0, "by_hand": True},
}


# The others differ from these by a number of balls or a distance.
FAST = ("triangle on rods", "body-centred bed", "by hand, on the plane")
FEW = [pytest.param(lab, id=name, marks=[pytest.mark.slow] * (name not in FAST)) for name, lab in LABS.items()]


@pytest.fixture
def no_others(monkeypatch):
    """No search of other arrangements, some forty traced labs each time, where nothing is said of them."""
    monkeypatch.setattr("rtpiv.analysis.views.arranged.others", lambda lab, lens: [])


@pytest.mark.usefixtures("no_others")
@pytest.mark.parametrize("lab", FEW)
def test_files_pass_the_check_on_their_own_benches(lab, tmp_path):
    files = init(tmp_path / "lab", GivenLab(**lab))
    assert [file.name for file in files] == [*FILES, BOARD]
    checks = check(tmp_path / "lab")
    assert all(isinstance(found, FileCheck) for found in checks)
    assert sum("steps" in found.said for found in checks) == 3
    for file in files:
        assert "#" in file.read_text()
        assert max(map(len, file.read_text().splitlines())) < 140
    scene = load_scene(tmp_path / "lab" / "scene.yaml")
    assert len(scene.spheres) == lab.get("balls", 9 if lab.get("arrangement") == "bcc" else 5)
    assert scene.wavelength_nm == lab.get("wavelength_nm", 532.0)


@pytest.mark.slow
@pytest.mark.usefixtures("no_others")
def test_balls_of_several_sizes_and_glasses_before_a_camera_that_looks_from_the_side(tmp_path, capsys):
    said = ["--ball-mm", "40", "30", "--glass", "acrylic", "BK7", "--turn-deg", "12", "--support-mm", "4"]
    assert main(["init", str(tmp_path), "--yes", *said]) == DONE
    assert "2 balls of 40, 30 mm acrylic, BK7, one behind the other" in capsys.readouterr().out
    scene = load_scene(tmp_path / "scene.yaml")
    near, far = scene.spheres
    assert (near.radius_mm, far.radius_mm) == (20.0, 15.0)
    assert far.centre_mm[2] - near.centre_mm[2] == pytest.approx(35.01)
    assert [ball.medium.name for ball in scene.spheres] == ["PMMA", "N-BK7"]
    x, _, z = scene.camera.position_mm
    assert math.degrees(math.atan2(x, z)) == pytest.approx(12.0, abs=1e-3)
    assert math.hypot(x, z) == pytest.approx(500.0, abs=1e-3)
    lens_mm = yaml.safe_load((tmp_path / "scene.yaml").read_text())["camera"]["f_mm"]
    lab = Lab(sizes_mm=(40.0, 30.0), glasses=("acrylic", "BK7"), turn_deg=12.0, lens_mm=lens_mm)
    assert scene.camera.focal_px == pytest.approx(scene_of(lab).camera.focal_px, rel=1e-6)
    assert scene.camera.rotation_matrix == pytest.approx(scene_of(lab).camera.rotation_matrix, abs=1e-6)
    assert all(isinstance(found, FileCheck) for found in check(tmp_path))


@pytest.mark.slow
@pytest.mark.usefixtures("no_others")
@pytest.mark.parametrize(
    "lab", [slow(LABS["one ball"], name="one"), pytest.param(LABS["triangle on rods"], id="triangle")]
)
def test_files_are_what_the_schemas_beside_them_say(lab, tmp_path):
    schemas = {}  # some files share one, and each is looked through once
    for file in init(tmp_path, GivenLab(**lab))[: len(FILES)]:
        name = file.read_text().splitlines()[0].partition("$schema=")[2]
        if name not in schemas:
            schemas[name] = jsonschema.Draft202012Validator(json.loads((tmp_path / name).read_text()))
            schemas[name].check_schema(schemas[name].schema)
        tree = yaml.safe_load(file.read_text())
        schemas[name].validate(tree)
        with pytest.raises(jsonschema.ValidationError):
            schemas[name].validate(tree | {"wavelength": 532.0})
        assert load_yaml(file).tree == tree


@loop_over(
    "arrangement, balls",
    [
        *(
            ("behind", 3),
            ("beside", 4),
            ("triangle", 3),
            ("pyramid", 4),
            ("pyramid", 5),
            ("sc", 8),
            ("sc", 27),
            ("bcc", 9),
        ),
        *(("bcc", 35), ("hcp", 10), ("hcp", 17)),
    ],
)
def test_balls_touch_and_do_not_overlap(arrangement, balls):
    centres = centres_mm(arrangement, balls, 40.0, 4.0)
    assert min(z for _, _, z in centres) == pytest.approx(24.0)
    apart = [math.dist(one, other) for one, other in itertools.combinations(centres, 2)]
    assert min(apart) == pytest.approx(40.01, abs=2e-4)
    assert sum(distance < 40.1 for distance in apart) >= balls - 1
    for start, end in rods_mm(centres, 40.0, 8.0):
        assert min(math.dist(start, centre) for centre in centres) == pytest.approx(24.01, abs=1e-3)
        assert end[1] < start[1]


@loop_over(
    "options, words",
    [
        (["--balls", "7", "--arrangement", "pyramid"], "a pyramid has 4, 5, not 7"),
        (["--glass", "marble"], "glass 'marble' is not known; known are acrylic"),
        (["--lens-mm", "600"], "cannot focus"),
        (["--distance-mm", "200", "--balls", "3", "--arrangement", "row"], "to move the glass"),
        (["--name", "my lab"], "letters, digits and underscores"),
        (["--gap-mm", "-3"], "gap_mm: should be a positive number"),
        (["--wavelength-nm", "0.532"], "300 to 2000"),
        (["--ball-mm", "40", "30", "--balls", "3"], "ball_mm: several are for balls behind or beside"),
        (["--glass", "BK7", "acrylic", "--arrangement", "sc"], "glass: several are for balls behind or beside"),
        (["--turn-deg", "80"], "turn_deg: should be -45 to 45, not 80"),
        (
            ["--balls", "7", "--glass", "marble", "--arrangement", "triangle"],
            "triangle has 3, not 7; glass 'marble'",
        ),
    ],
)
def test_what_cannot_be_is_one_sentence_and_nothing_is_written(options, words, tmp_path, capsys):
    assert main(["init", str(tmp_path / "lab"), "--yes", *options]) == USAGE
    said = capsys.readouterr().err
    assert words in said
    assert len(said.splitlines()) == 1
    assert not (tmp_path / "lab").exists()


@pytest.mark.usefixtures("no_others")
def test_files_of_a_person_are_not_replaced(tmp_path, capsys):
    (tmp_path / "scene.yaml").write_text("mine")
    assert main(["init", str(tmp_path), "--yes"]) == USAGE
    assert "scene.yaml is there already" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["scene.yaml"]
    assert main(["init", str(tmp_path), "--yes", "--overwrite"]) == DONE
    assert "wavelength_nm" in (tmp_path / "scene.yaml").read_text()


@pytest.fixture
def terminal(monkeypatch):
    """What is written here is typed at a terminal, from which this process reads."""
    here, there = pty.openpty()
    with os.fdopen(there) as typed:
        monkeypatch.setattr(sys, "stdin", typed)
        yield here
    os.close(here)


@pytest.mark.usefixtures("no_others")
def test_by_questions_at_a_terminal(tmp_path, terminal, capsys):
    """Nonsense is asked again; what options say is not asked."""
    lines = [
        "5.5",
        "600",
        "triangel",
        "triangle",
        "thirty",
        "30",
        "Plexiglas",
        "",
        "6",
        "",
        "3",
        "",
        "perhaps",
        "yes",
    ]
    os.write(terminal, ("\n".join(lines) + "\n\x04").encode())  # one question more ends it
    assert main(["init", str(tmp_path / "lab"), "--sensor-px", "640", "480"]) == DONE
    said = capsys.readouterr().out
    assert "width and height" not in said
    assert "arrangement 'triangel': there are behind, beside, triangle, pyramid, sc, bcc, hcp" in said
    assert "'thirty' cannot be read" in said
    assert "'perhaps' cannot be read; enter for example no" in said
    assert "board: squares of 3 mm" in said
    assert "driver: by_hand" in (tmp_path / "lab" / "bench.yaml").read_text()
    assert "target: {square_mm: 3, disc_mm: 1.2}" in (tmp_path / "lab" / "bench.yaml").read_text()
    scene = load_scene(tmp_path / "lab" / "scene.yaml")
    assert [ball.radius_mm for ball in scene.spheres] == [15.0] * 3
    assert len(scene.bodies) == 5
    assert scene.camera.position_mm == (0.0, 0.0, 600.0)


def test_the_end_of_the_answers_writes_nothing(tmp_path):
    here, there = pty.openpty()
    command = [sys.executable, "-m", "rtpiv", "init", str(tmp_path / "lab")]
    asked = subprocess.Popen(command, stdin=there, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    os.close(there)
    os.write(here, b"640 480\n\x04")
    said, _ = asked.communicate(timeout=120)
    os.close(here)
    assert asked.returncode == 4, said
    assert not (tmp_path / "lab").exists()


def test_every_question_has_a_usual_answer():
    only_options = {"name", "sizes_mm", "glasses", "turn_deg", "layers", "plane"}
    assert {question.key for question in QUESTIONS} == set(vars(Lab())) - only_options


@pytest.mark.slow
@pytest.mark.usefixtures("no_others")
def test_the_print_is_the_board_that_the_bench_hangs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    init(".", GivenLab())
    hung = load_bench("bench.yaml").board
    made = target("board.yaml", out="print")
    assert "rtpiv setup target board.yaml --measured-mm" in capsys.readouterr().out
    assert made.path.stat().st_size > 1000
    assert not (tmp_path / "print" / "board.yaml").exists()
    assert load_bench("bench.yaml").board == hung
    target("board.yaml", measured_mm=(189.5, 279.9))
    assert load_bench("bench.yaml").board.scale == pytest.approx((189.5 / 190.0, 279.9 / 280.0))
    target("board.yaml", out="again")
    assert "the measure of an earlier print is taken out" in " ".join(capsys.readouterr().out.split())
    assert load_bench("bench.yaml").board == hung
    with pytest.raises(RunUsageError, match="leave --kind and --square-mm out"):
        target("board.yaml", square_mm=3.0, out="another")
    target(out="a3", paper="A3", square_mm=5.0)
    with pytest.raises(RunUsageError, match=r"squares and origin_corner are not those .* give its --paper"):
        target("a3/board.yaml", out="another")
    target("a3/board.yaml", out="another", paper="A3")
    (tmp_path / "board.yaml").write_text("kind: chessboard\nsquare_mm: 2.5\ndisc_mm: 0.9\n")
    with pytest.raises(RunUsageError, match="print it with the program that made it"):
        target("board.yaml", out="another")
    assert GivenLab(square_mm=3.0).words == {"square_mm": 3.0}


@loop_over("gap_mm, lifts", [(30.0, False), (2.0, True)])
def test_no_axis_of_a_lab_without_motors_has_one_and_its_plans_ask_for_few_places(gap_mm, lifts):
    """Only glass that stands in the light sheet of a flow needs a screw that lifts it."""
    lab = Lab(by_hand=True, gap_mm=gap_mm)
    room = room_of(lab)
    for laser in (False, True):
        stages = yaml.safe_load(bench_text(lab, room, laser))["stages"]
        assert [box["driver"] for box in stages["controllers"].values()] == ["by_hand"]
        assert all(axis["reading_um"] > 0.0 for axis in stages["axes"].values())
        assert ("glass_z" in stages["axes"]) == (laser and lifts)
    target, shift = (yaml.safe_load(text) for text in (target_plan(lab, room), shift_plan(lab)))
    heights = [*target["clear"]["z_mm"], *target["glass"]["z_mm"]]
    assert heights[2:4] == [0.0, 0.0]  # the board stays while the glass slides in
    assert len({*heights}) == len(heights) - 1
    assert max(heights) <= 0.0
    assert shift["views"] == ["glass"]


def test_row_and_side_are_other_names_of_behind_and_beside():
    for old, new in (("row", "behind"), ("side", "beside")):
        assert Lab(arrangement=old) == Lab(arrangement=new)
        assert usual(None, old) == (2, new)


def test_the_usual_lens_is_the_longest_that_sees_what_the_balls_hide():
    """Whether the next lens sees it too is asked of cones that touch the balls, not of the rule."""
    for lab in (Lab(), Lab(balls=3, arrangement="triangle", gap_mm=4.0), Lab(balls=1, distance_mm=900.0)):
        usual = lab.with_usual_lens()
        longer = replace(usual, lens_mm=LENSES_MM[LENSES_MM.index(usual.lens_mm) + 1])
        seen, cut = (coarse_hidden_mm2(one) for one in (usual, longer))
        whole = coarse_hidden_mm2(replace(usual, lens_mm=12.0))
        assert seen == pytest.approx(whole, rel=0.02)
        assert cut < whole * 1.01
        assert min(longer.field_mm) < 1.2 * max(lab.span_mm) * lab.distance_mm / (lab.distance_mm - 40.0)


def coarse_hidden_mm2(lab):
    found = coarse_map(scene_of(lab))
    return through_glass(scene_of(lab), found.grid, found.recovered).hidden_mm2


def test_by_itself_it_lays_out_what_shows_most_of_what_the_balls_hide(tmp_path, capsys):
    init(tmp_path / "lab")
    said = capsys.readouterr().out
    share = traced_share(tmp_path / "lab" / "scene.yaml")
    assert share > 0.9
    assert f"through glass: {percent(share)} of what the balls hide" in said
    rows = [line.split() for line in said.splitlines() if line.strip().endswith("%")]
    assert ["1", "behind"] in [row[:2] for row in rows]
    assert ["3", "triangle"] in [row[:2] for row in rows]


@pytest.mark.usefixtures("no_others")
@pytest.mark.parametrize(
    "lab", [{"balls": 3, "support_mm": 6.0}, slow({"balls": 1, "glass": "1.7"}), slow({"balls": 5})]
)
def test_where_no_distance_is_said_the_balls_stand_where_they_show_much(lab, tmp_path):
    init(tmp_path / "lab", GivenLab(**lab))
    assert traced_share(tmp_path / "lab" / "scene.yaml") > 0.35


def test_a_distance_that_is_asked_for_is_kept_and_what_would_show_more_comes_first(tmp_path, capsys, request):
    init(tmp_path / "lab", GivenLab(balls=3, gap_mm=4.0))
    said = capsys.readouterr().out
    assert "through glass: 1." in said
    assert "shows little through its glass; what shows more" in said
    first = next(line.split() for line in said.splitlines() if line.split()[:2] == ["3", "triangle"])
    request.getfixturevalue("no_others")
    init(tmp_path / "other", GivenLab(balls=3, gap_mm=float(first[2]), lens_mm=float(first[3])))
    assert percent(traced_share(tmp_path / "other" / "scene.yaml")) == f"{first[4]} %"


@pytest.mark.usefixtures("no_others")
def test_a_lens_that_sees_a_part_of_the_balls_is_told_with_one_that_sees_them(tmp_path, capsys):
    init(tmp_path / "long", GivenLab(balls=3, lens_mm=200.0))
    said = capsys.readouterr().out
    shorter = re.search(r"shows little through its glass: its balls are .* --lens-mm (\S+) or", said)
    init(tmp_path / "short", GivenLab(balls=3, lens_mm=float(shorter[1])))
    assert "shows little" not in capsys.readouterr().out


@pytest.mark.usefixtures("no_others")
def test_the_target_is_lit_by_the_laser_until_somebody_says_another_light(tmp_path):
    """Nobody is told of a lamp on the simulated bench, and whoever writes a wavelength there is."""
    init(tmp_path, GivenLab(wavelength_nm=488.0))
    scene = tmp_path / "scene.yaml"
    light = load_priors(scene).light
    assert light == LightTable(source="laser")
    assert (light.light(488.0).mean_nm, light.light(488.0).unsure_nm) == (488.0, 0.0)
    text = scene.read_text()
    scene.write_text(text.replace("light: {source: laser}", "light: {mean_nm: 530}"))
    assert load_priors(scene).light.light(488.0).unsure_nm > 0.0


def traced_share(scene_file):
    """The share by the whole map."""
    scene = load_scene(scene_file)
    found = build_correction_map(scene, build_ray_map(scene))
    return through_glass(scene, found.grid, found.recovered).share


BEDS = {"sc": 8, "hcp": 10, "bcc": 9}


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("shape", BEDS)
def test_beds_are_acquired_and_fitted_on_their_simulated_benches(shape, tmp_path, monkeypatch):
    """Each packed bed once, from `init` to a fit: the model holds, and residuals are what their sigmas say."""
    monkeypatch.chdir(tmp_path)
    bed = {"arrangement": shape, "balls": BEDS[shape], "ball_mm": 20.0}
    init(tmp_path, GivenLab(sensor_px=(640, 640), pixel_pitch_um=9.0, **bed))
    run = acquire("plan-target.yaml", bench="bench.yaml", simulate=True, home=True)
    fit = calibrate(run, out="fit", pictures=False)
    assert fit.verdict.is_right
    assert not fit.light.sentence  # the scene file of `init` says what lights its target
    found = json.loads((tmp_path / "fit" / "calibration.json").read_text())
    assert found["through_glass"] > 0.2
    for way in found["model"]["ways"]:
        spread = (
            4.0 / way["corners"] ** 0.5
        )  # four sigmas of a mean of 2 N squares, and as much for what is taken off
        assert abs(way["rough_square"] - 1.0) < 0.15 + spread, way
    assert found["map_sigma_px"]["behind glass"]["median"] < 0.2  # nobody has measured the print


@loop_over(
    "words, named",
    [
        (("--ball-mm", "0.012", "--square-mm", "0.004"), "ball_mm: 0.012 mm are 1.4 px"),
        (("--square-mm", "0.004"), "square_mm: 0.004 mm are"),
    ],
)
def test_metres_for_millimetres_are_refused_by_name(tmp_path, capsys, words, named):
    assert main(["init", str(tmp_path / "lab"), "--yes", *words]) == USAGE
    said = " ".join(capsys.readouterr().err.split())
    assert named in said
    assert "m for mm?" in said
    assert not (tmp_path / "lab").exists()
