"""A person's bench file: exactly what is asked for changes, everything else stays as it was typed."""

import os

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from daq.bench.bench_edit import difference, edit_values, replace_file, with_values
from daq.errors import RunUsageError
from ground.errors import ConfigError

AFTER = {"scene_at_mm": "scene"}
FLOW = """# the bench of room 7
name: room_7      # as on the door
scene: two.yaml   # holds where
scene_at_mm: {rail_z: 500.0, glass_y: -1.0}   # measured on Monday

stages:
  controllers:
    rail: {driver: isel_dnc, port: /dev/ttyUSB0}   # old
    glass:
      port: /dev/ttyUSB1   # new
      driver: zaber_ascii

  # order counts
  home_order: [rail_z]
"""
BLOCK = FLOW.replace(
    "scene_at_mm: {rail_z: 500.0, glass_y: -1.0}   # measured on Monday\n",
    "scene_at_mm:\n  rail_z: 500.0   # tape\n  # guessed:\n  glass_y: -1.0   # eye\n  # end of guesses\n",
)
NONE = FLOW.replace("scene_at_mm: {rail_z: 500.0, glass_y: -1.0}   # measured on Monday\n", "")
AXES = ("rail_z", "glass_y", "camera_x")


def lines_changed(before, after):
    return [line for line in difference_lines(before, after) if line[0] in "+-"]


def difference_lines(before, after):
    from pathlib import Path

    return difference(Path("b.yaml"), before, after).splitlines()[2:]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (FLOW, ["-scene_at_mm: {rail_z: 500.0, glass_y: -1.0}   # measured on Monday",
                "+scene_at_mm: {rail_z: 12.5, glass_y: -1.0, camera_x: 3.0}   # measured on Monday"]),
        (BLOCK, ["-  rail_z: 500.0   # tape", "+  rail_z: 12.5   # tape", "+  camera_x: 3.0"]),
        (NONE, ["+scene_at_mm: {rail_z: 12.5, camera_x: 3.0}"]),
    ],
    ids=["flow", "block", "none"],
)  # fmt: skip
def test_positions_in_every_layout(text, said):
    values = {("scene_at_mm", "rail_z"): 12.5, ("scene_at_mm", "camera_x"): 3.0}
    after = with_values(text, values, AFTER)
    assert lines_changed(text, after) == said
    found = yaml.safe_load(after)["scene_at_mm"]
    assert found["rail_z"] == 12.5
    assert found["camera_x"] == 3.0


def test_identities_in_both_layouts():
    at = ("stages", "controllers")
    values = {(*at, "rail", "identity"): "iMC-S8 V2.1", (*at, "glass", "identity"): 'a "quoted", odd: one # 7'}
    after = with_values(FLOW, values, AFTER)
    assert lines_changed(FLOW, after) == [
        "-    rail: {driver: isel_dnc, port: /dev/ttyUSB0}   # old",
        "+    rail: {driver: isel_dnc, port: /dev/ttyUSB0, identity: iMC-S8 V2.1}   # old",
        '+      identity: "a \\"quoted\\", odd: one # 7"',
    ]
    controllers = yaml.safe_load(after)["stages"]["controllers"]
    assert controllers["glass"]["identity"] == 'a "quoted", odd: one # 7'


@pytest.mark.slow
@settings(max_examples=10)
@given(
    text=st.sampled_from([FLOW, BLOCK, NONE]),
    crlf=st.booleans(),
    values=st.dictionaries(st.sampled_from(AXES), st.floats(-2000.0, 2000.0), min_size=1),
    words=st.none()
    | st.text(st.characters(codec="utf-8", exclude_categories=["Cs", "Cc"]), min_size=1, max_size=40),
)
def test_whatever_is_written_is_read_back_and_nothing_else_changes(tmp_path_factory, text, crlf, values, words):
    path = tmp_path_factory.mktemp("edit") / "bench.yaml"
    path.write_bytes((text.replace("\n", "\r\n") if crlf else text).encode())
    wanted = {("scene_at_mm", name): mm for name, mm in values.items()}
    if words is not None:
        wanted["stages", "controllers", "glass", "identity"] = words
    before, after = edit_values(path, wanted, AFTER)
    tree, old = yaml.safe_load(after), yaml.safe_load(before)
    for name, mm in values.items():
        assert tree["scene_at_mm"].pop(name) == pytest.approx(mm, abs=0.5e-4)
        old.get("scene_at_mm", {}).pop(name, None)
    if not tree["scene_at_mm"]:
        tree.pop("scene_at_mm")
        old.pop("scene_at_mm", None)
    if words is not None:
        assert tree["stages"]["controllers"]["glass"].pop("identity") == words
    assert tree == old
    assert [line for line in before.splitlines() if "#" in line] == [
        line for line in before.splitlines() if "#" in line and line.partition("#")[2] in after
    ]
    assert ("\r\n" in after) == crlf
    assert after.count("\n") == after.count("\r\n") or not crlf


@pytest.mark.parametrize(
    "text",
    [
        FLOW.replace("{rail_z: 500.0, glass_y: -1.0}", "&here {rail_z: 500.0}").replace(
            "stages:\n", "other: *here\nstages:\n"
        ),
        FLOW.replace("scene_at_mm: {rail_z: 500.0, glass_y: -1.0}", "scene_at_mm: [1.0]"),
        NONE.replace("scene:", "picture:"),
    ],
    ids=["alias", "list", "no anchor"],
)
def test_a_layout_that_cannot_be_edited_is_left_alone(tmp_path, text):
    path = tmp_path / "bench.yaml"
    path.write_text(text)
    with pytest.raises(RunUsageError, match="by hand"):
        edit_values(path, {("scene_at_mm", "rail_z"): 1.0}, AFTER)
    assert path.read_text() == text


def test_a_file_that_became_wrong_meanwhile_is_said_with_its_line(tmp_path):
    path = tmp_path / "bench.yaml"
    path.write_text(FLOW + "name: again\n")
    with pytest.raises(ConfigError, match="already given in line 2"):
        edit_values(path, {("scene_at_mm", "rail_z"): 1.0}, AFTER)


def test_the_old_file_is_kept_with_its_rights(tmp_path):
    path = tmp_path / "bench.yaml"
    path.write_text("old")
    path.chmod(0o640)
    kept = replace_file(path, "new")
    assert (path.read_text(), kept.read_text()) == ("new", "old")
    assert path.stat().st_mode & 0o777 == 0o640
    assert replace_file(path, "newer") != kept
    assert {p.name for p in tmp_path.iterdir() if p.suffix == ".part"} == set()


def test_nothing_is_lost_if_it_cannot_be_written(tmp_path, mocker):
    path = tmp_path / "bench.yaml"
    path.write_text("old")
    mocker.patch.object(os, "fsync", side_effect=OSError(28, "No space left on device"))
    with pytest.raises(Exception, match="No space left"):
        replace_file(path, "new")
    assert path.read_text() == "old"
