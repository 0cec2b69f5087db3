"""`rtpiv check FILE...`: every problem of every file at once, plans tried on their bench, nothing opened."""

import importlib
import re

import pytest

from daq.errors import RunUsageError
from rtpiv.command_line.cli import DONE, USAGE, main
from rtpiv.verbs.check import check
from rtpiv.verbs.init import GivenLab, init


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("lab")
    init(folder, GivenLab(balls=1, sensor_px=(640, 480)))
    return folder


@pytest.fixture
def lab(made, tmp_path):
    for file in made.glob("*.yaml"):
        (tmp_path / file.name).write_bytes(file.read_bytes())
    return tmp_path


def change(file, old, new):
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new, 1))


def test_a_folder_of_files(lab, capsys):
    capsys.readouterr()
    assert main(["check", str(lab)]) == DONE
    said = capsys.readouterr().out
    assert len(said.splitlines()) == 7
    assert re.search(r"board.yaml  ok  board: ", said)
    assert re.search(
        r"scene.yaml  ok  scene: 1 sphere; camera of 640 x 480 px, \d+.\d px/mm.*; through glass: \d+ % of", said
    )
    assert re.search(
        r"bench.yaml  ok  bench: 9 axes on 4 controllers, camera by harvesters; .*can be simulated", said
    )
    assert re.search(
        r"plan-target.yaml  ok  plan: target, 8 steps, 8 frames, about \d+ s on hardware, \d+ s simulated on", said
    )
    assert re.search(
        r"plan-flow.yaml  ok  plan: flow, 2 steps, 60 frames, about \d+ s on hardware, \d+ s simulated on an idle"
        r" computer; link: .* MB/s.* on bench-flow.yaml",
        said,
    )


def test_a_scene_that_shows_little_through_glass_says_what_would_show_more(tmp_path, capsys):
    init(tmp_path / "lab", GivenLab(balls=3, gap_mm=4.0, sensor_px=(640, 480)))
    capsys.readouterr()
    check(tmp_path / "lab" / "scene.yaml")
    said = capsys.readouterr().out
    assert re.search(r"through glass: \d(\.\d)? % of what the balls hide.*Little of what the glass hides", said)
    assert re.search(r"What would show more: .*: \d\d %", said)


def test_problems_of_all_files_at_once(lab, capsys):
    change(lab / "scene.yaml", "'acrylic'", "'acrilic'")
    change(lab / "bench.yaml", "speed_mm_s: 30.0", "speed_mm: 30.0")
    change(lab / "bench.yaml", "lead_mm: 5.0", "lead: 5.0")
    change(lab / "plan-shift.yaml", "px: 10.0", "px: ten")
    (lab / "notes.yaml").write_text("shopping: [milk]\n")
    assert main(["check", *map(str, sorted(lab.glob("*.yaml")))]) == USAGE
    said = capsys.readouterr().err
    lines = said.removeprefix("rtpiv check: ").splitlines()
    assert len(lines) == len(set(lines))
    for words in (
        "did you mean 'acrylic'",
        "unknown key 'stages.axes.rail_z.speed_mm'; did you mean 'speed_mm_s'",
        "displacements.1.px: should be a number, not 'ten'",
        "notes.yaml:1: is no file of ours",
    ):
        assert words in said, said


PLATE = """kind: dots
pitch_mm: 2.5
dot_mm: 1.0
large_dot_mm: 1.7
levels: rows
step_mm: 1.0
"""


def test_a_board_file_is_looked_at_beside_the_bench_that_names_it(lab):
    (lab / "plate.yaml").write_text(PLATE)
    change(lab / "bench.yaml", "board: board.yaml", "board: plate.yaml")
    found = {one.path.name: one for one in check(lab)}
    assert found["plate.yaml"].kind == "board"
    assert found["plate.yaml"].said == (
        "dots of 2.5 mm, by rows on two levels 1 mm apart; width and height known to 0.01 and 0.01 %"
    )
    for old, new, words in (
        ("step_mm: 1.0", "step_mm: 4.0", r"plate.yaml:.*at most 0.8 of pitch_mm"),
        ("large_dot_mm: 1.7", "large_dot_mm: 1.1", r"plate.yaml:.*large dots of 1.1 mm are too like"),
        ("levels: rows", "levels: rings", r"plate.yaml:.*levels"),
    ):
        change(lab / "plate.yaml", old, new)
        with pytest.raises(RunUsageError, match=words):
            check(lab / "plate.yaml")
        change(lab / "plate.yaml", new, old)


def test_the_simulation_is_looked_at_as_well(lab):
    change(lab / "bench.yaml", "lead_mm: 5.0", "lead: 5.0")
    with pytest.raises(
        RunUsageError, match=r"bench.yaml:\d+: unknown key 'axes.rail_z.lead'; did you mean 'lead_mm'"
    ):
        check(lab / "bench.yaml")


def test_a_plan_that_a_bench_must_not_carry_out(lab):
    change(lab / "plan-target.yaml", "glass: {z_mm: [0.0", "glass: {z_mm: [60.0")
    with pytest.raises(RunUsageError, match=r"step 6 \(target_glass_z\+60mm\) is not allowed on bench.yaml"):
        check([lab / "plan-target.yaml"])
    found = check([str(lab / "plan-shift.yaml")], bench=str(lab / "bench.yaml"))
    assert "4 steps" in found[0].said


def test_a_plan_without_a_bench(lab):
    (lab / "bench.yaml").unlink()
    (found,) = check(lab / "plan-target.yaml")
    assert "no bench is given" in found.said


@pytest.mark.parametrize("name", ["missing.yaml", "empty"])
def test_nothing_to_check(lab, name, capsys):
    (lab / "empty").mkdir()
    assert main(["check", str(lab / name)]) == USAGE
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_acquire_says_what_is_wrong_with_bench_and_plan_at_once(lab, capsys):
    change(lab / "bench.yaml", "speed_mm_s: 30.0", "speed_mm: 30.0")
    change(lab / "plan-shift.yaml", "px: 10.0", "px: ten")
    words = ["acquire", str(lab / "plan-shift.yaml"), "--bench", str(lab / "bench.yaml"), "--simulate"]
    assert main(words) == USAGE
    said = capsys.readouterr().err
    assert "did you mean 'speed_mm_s'" in said
    assert "displacements.1.px: should be a number" in said


def test_settings_of_piv(tmp_path):
    (tmp_path / "piv.yaml").write_text("final_window_px: 16\noverlap: 0.75\n")
    assert check(tmp_path / "piv.yaml")[0].said == "last windows of 16 px"
    (tmp_path / "piv.yaml").write_text("finest_window_px: 12\n")
    assert check(tmp_path / "piv.yaml")[0].said == "last windows of 32 px, or 12 px where they show more"
    (tmp_path / "piv.yaml").write_text("overlap: 2\n")
    with pytest.raises(RunUsageError, match="overlap: should be less than 1, not 2"):
        check(tmp_path / "piv.yaml")


def test_a_file_is_told_before_the_next_one_is_looked_at(lab, capsys, monkeypatch):
    """A scene may have kernels to compile for minutes; what is right stands there by then, whatever comes."""
    said, check_verb = [], importlib.import_module("rtpiv.verbs.check")  # the verb has its module's name
    looked = check_verb.load_scene

    def slow(path):
        said.append(capsys.readouterr().out)
        return looked(path)

    monkeypatch.setattr(check_verb, "load_scene", slow)
    assert main(["check", str(lab / "plan-target.yaml"), str(lab / "scene.yaml")]) == DONE
    assert "plan-target.yaml  ok" in said[0]
