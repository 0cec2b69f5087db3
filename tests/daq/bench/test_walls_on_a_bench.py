"""Windows stand, tubes that hold balls go with them: for runs, pictures, keep-out and witness.

Runs and the simulated bench once moved a furnace's window with the glass alike, and no test between them could
tell.  So what is right is worked out here by hand, from the axes.
"""

import numpy as np
import pytest

from daq.bench.bench_file import load_bench
from daq.bench.elements import GLASS
from daq.bench.guards import guard_of, sheet_clearance_mm, sheet_clearances_mm
from daq.runs.glass_place import glass_off_scene_mm, with_glass_at
from ground.errors import ConfigError
from sim.arranged import arrange
from sim.witness.clearances import Carried, Clearances
from stages.errors import Obstructed, StageUsageError
from stages.way import Piece
from tests.daq.small_bench import write_bench
from tracer.scene.scene_file import dump_scene, load_scene

PANE = "{name: pane, kind: window, centre_mm: [0, 0, 200], normal: [0, 0.1, 1], thickness_mm: 10, radius_mm: 60, "
PANE += "material: BK7CARRIED}"
TUBE = "{name: tube, kind: tube, start_mm: [0, -60, 50], end_mm: [0, 60, 50], outer_radius_mm: 68, "
TUBE += "inner_radius_mm: 65, material: BK7CARRIED}"
GLASS_Z = {"glass_z": 30.0}


def bench_file(folder, *walls, carried_by=None, keep_out=""):
    path = write_bench(folder)
    scene = path.parent / "scene.yaml"
    said = "" if carried_by is None else f", carried_by: {carried_by}"
    lines = "".join(f"  - {wall.replace('CARRIED', said)}\n" for wall in walls)
    scene.write_text(scene.read_text().replace("bodies:\n", f"bodies:\n{lines}", 1))
    if keep_out:
        path.write_text(path.read_text().replace("  target_size_mm: [160.0, 160.0, 5.0]", f"  {keep_out}"))
    return path


def places(scene):
    """Name of each body -> points of it [mm]."""
    return {body.name: body.outline_mm[0] for body in scene.bodies}


@pytest.mark.parametrize(
    ("carried_by", "step_mm"), [(None, 0.0), ("bench", 0.0), ("glass", 30.0), ("camera", 7.0)]
)
def test_a_window_goes_where_its_carrier_goes(tmp_path, carried_by, step_mm):
    bench = load_bench(bench_file(tmp_path, PANE, carried_by=carried_by))
    at = bench.home_mm | GLASS_Z | {"rail_z": 7.0}
    off = {"pane": step_mm, "near": 30.0, "far": 30.0}
    shown, _ = arrange(bench, bench.scene, at)
    for name, points in places(bench.scene).items():
        np.testing.assert_allclose(places(shown)[name], points + np.array([0.0, 0.0, off[name]]))
    taken = with_glass_at(bench.scene, glass_off_scene_mm(bench.table, bench.home_mm | GLASS_Z))
    off |= {"pane": 30.0 if carried_by == "glass" else 0.0}  # the camera stands where the scene holds
    for name, points in places(bench.scene).items():
        np.testing.assert_allclose(places(taken)[name], points + np.array([0.0, 0.0, off[name]]))
    assert [body.name for body in bench.scene.bare().bodies] == ([] if carried_by == "glass" else ["pane"])


def test_a_map_by_a_window_that_stood_is_not_one_by_a_window_that_moved(tmp_path):
    scenes = [load_bench(bench_file(tmp_path / who, PANE, carried_by=who)).scene for who in ("bench", "glass")]
    stood, went = (with_glass_at(scene, (0.0, 0.0, 30.0)).content_hash() for scene in scenes)
    assert scenes[0].content_hash() == scenes[1].content_hash()
    assert stood != went


def test_a_tube_that_holds_balls_must_go_with_them(tmp_path):
    with pytest.raises(ConfigError, match="'tube' is carried by the bench, near in it by the glass: glass_x"):
        load_bench(bench_file(tmp_path / "stands", TUBE))
    bench = load_bench(bench_file(tmp_path / "goes", TUBE, carried_by="glass"))
    assert bench.scene.bare().bodies == ()
    assert load_scene(_written(tmp_path, dump_scene(bench.scene))) == bench.scene
    standing = load_bench(bench_file(tmp_path / "window", PANE))
    assert standing.has_glass
    assert bench.content_hash() != standing.content_hash()


def test_a_window_alone_is_no_glass_that_is_driven_out(tmp_path):
    path = bench_file(tmp_path, PANE)
    scene = path.parent / "scene.yaml"
    scene.write_text("".join(line for line in scene.read_text().splitlines(True) if "sphere" not in line))
    path.write_text(
        path.read_text().replace("  contact: [near]                  # touches the target in the scene\n", "")
    )
    assert not load_bench(path).has_glass


def way(bench, axis, end_mm, **others):
    here = bench.home_mm | others
    return Piece(axis, here[axis], end_mm, here)


def seen(bench, piece):
    """What the witness says of the same way."""
    carried = {
        name: Carried(axis.carries, "xyz".index(axis.along), bench.home_mm[name])
        for name, axis in bench.table.stages.axes.items()
    }
    judge = Clearances(bench.scene, carried, bench.table.keep_out, dict.fromkeys(carried, 0.0))
    for name, at_mm in piece.others_mm.items():
        judge.put(name, piece.start_mm if name == piece.axis else at_mm)
    return judge.judge_motion({piece.axis: piece.end_mm}, {piece.axis}, {})


@pytest.mark.parametrize(
    ("axis", "end_mm", "others", "free"),
    [
        ("glass_z", 80.0, {}, True),  # the far ball's pole at z = 180 then, the plate's back at 190
        ("glass_z", 95.0, {}, False),
        ("rail_z", -150.0, {}, True),  # the lens ends at z = 500 - 150 - 60 - 50
        ("rail_z", -245.0, {}, False),
        ("glass_y", -130.0, {"glass_z": 80.0}, True),
    ],
)
def test_a_standing_window_is_in_the_way_of_what_moves(tmp_path, axis, end_mm, others, free):
    upright = PANE.replace("[0, 0.1, 1]", "[0, 0, 1]")
    bench = load_bench(bench_file(tmp_path, upright))
    piece = way(bench, axis, end_mm, **others)
    found = seen(bench, piece)
    if free:
        guard_of(bench).check([piece])
        assert found == []
    else:
        with pytest.raises(Obstructed, match="pane"):
            guard_of(bench).check([piece])
        assert "pane" in {name for one in found for name in (one.one, one.other)}


def test_a_window_the_glass_carries_is_never_in_its_own_way(tmp_path):
    upright = PANE.replace("[0, 0.1, 1]", "[0, 0, 1]")
    bench = load_bench(bench_file(tmp_path, upright, carried_by="glass"))
    piece = way(bench, "glass_z", 95.0)
    guard_of(bench).check([piece])
    assert seen(bench, piece) == []
    with pytest.raises(Obstructed, match="pane"):
        guard_of(bench).check([way(bench, "glass_z", 195.0)])  # into the lens


def test_a_tube_is_hollow(tmp_path):
    """The board hangs in the tube; a ball around it would have forbidden every move, or allowed every one."""
    around = TUBE.replace("50]", "0]").replace("68", "108").replace("65", "105")
    bench = load_bench(
        bench_file(tmp_path, around, carried_by="glass", keep_out="target_size_mm: [60.0, 60.0, 5.0]")
    )
    free, into = way(bench, "glass_x", 60.0), way(bench, "glass_x", 74.0)  # the wall's inside from 105 to 45 mm
    guard_of(bench).check([free])
    assert seen(bench, free) == []
    with pytest.raises(Obstructed, match=r"would bring tube to 1\.\d+ mm from the target"):
        guard_of(bench).check([way(bench, "glass_x", 73.0)])
    assert [one for one in seen(bench, into) if one.one == "tube"]
    with pytest.raises(StageUsageError, match=r"the target is [\d.]+ mm deep in 'tube'"):
        guard_of(
            load_bench(
                bench_file(tmp_path / "wide", around, carried_by="glass", keep_out="target_size_mm: [220, 60, 5]")
            )
        )


def test_the_sheet_is_as_far_from_a_plate_as_it_stands_there(tmp_path):
    near = PANE.replace("[0, 0, 200]", "[0, 0, 120]").replace("[0, 0.1, 1]", "[0, 0, 1]")
    bench = load_bench(bench_file(tmp_path, near))
    up = bench.home_mm | {"glass_z": 300.0, "target_z": -300.0}
    assert sheet_clearance_mm(bench, up) == pytest.approx(110.0)  # not from the ball of 60 mm around it
    around = TUBE.replace("50]", "0]").replace("68", "108").replace("65", "105")
    tube = load_bench(bench_file(tmp_path / "tube", around, carried_by="glass"))
    assert sheet_clearance_mm(tube, tube.home_mm | {"glass_z": 4.0, "target_z": -30.0}) == pytest.approx(4.0)
    assert GLASS in {axis.carries for axis in tube.table.stages.axes.values()}


@pytest.mark.parametrize("wall", [PANE, TUBE])
def test_pieces_cover_the_wall_and_little_more(tmp_path, wall):
    body = load_bench(bench_file(tmp_path, wall, carried_by="glass")).scene.bodies[0]
    rng = np.random.default_rng(2)
    points = rng.uniform(-80.0, 80.0, (20_000, 3)) + body.outline_mm[0].mean(axis=0)
    inside = np.min([_beyond(piece, points) for piece in body.pieces], axis=0) <= 0.0
    true_mm = body.distance_mm(points)
    assert inside[true_mm <= 0.0].all()
    assert (true_mm <= 0.0).sum() > 200
    assert true_mm[inside].max() < 6.0  # the rim of the plate is rounded outwards, by half its thickness


def _beyond(piece, points):
    """How far points are outside of a piece: sums of edges are sampled finely, as they lie in one plane."""
    if len(piece.edges_mm) == 2:
        (a, b), w = piece.edges_mm, points - piece.start_mm
        s, t = np.clip(w @ a / (a @ a), 0.0, 1.0), np.clip(w @ b / (b @ b), 0.0, 1.0)
        return np.linalg.norm(w - s[:, None] * a - t[:, None] * b, axis=1) - piece.radius_mm
    middle, normal = piece.start_mm + 0.5 * piece.edges_mm.sum(axis=0), np.cross(*piece.edges_mm[[0, 4]])
    w = points - middle
    normal /= np.linalg.norm(normal)
    along = w @ normal
    flat = w - along[:, None] * normal
    beside = np.max(
        [
            np.abs(flat @ np.cross(normal, e)) / np.linalg.norm(e) - _reach(piece, np.cross(normal, e))
            for e in piece.edges_mm
        ],
        axis=0,
    )
    return np.hypot(along, np.maximum(beside, 0.0)) - piece.radius_mm


def _reach(piece, way_mm):
    return 0.5 * np.abs(piece.edges_mm @ way_mm).sum() / np.linalg.norm(way_mm)


def _written(folder, text):
    path = folder / "written.yaml"
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    ("sheet_mm", "wanted"),
    [
        (0.2, {"glass": -0.2, "target": 30.2}),  # a ball on the target's plane is in its way, not in a bed
        (25.0, {"glass": 25.0, "target": 55.0}),  # through `near`, which is meant to be there
        (-5.0, {"glass": 5.0, "target": 25.0}),
    ],
)
def test_what_is_clear_of_a_sheet_is_measured_from_the_sheet(tmp_path, sheet_mm, wanted):
    path = write_bench(tmp_path)
    scene = path.parent / "scene.yaml"
    scene.write_text(scene.read_text() + f"\nsheet: {{z_mm: {sheet_mm}}}\n")
    bench = load_bench(path)
    found = sheet_clearances_mm(bench, bench.home_mm | {"target_z": -30.0})
    nearest = {name: min(mm for each, mm in found if each == name) for name, _ in found}
    assert nearest == pytest.approx(wanted)
