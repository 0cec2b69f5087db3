"""Keep-out against brute force, and on the bench of the paper."""

import time

import numpy as np
import pytest

from daq.bench.keep_out import Carrier, KeepOut, KeepOutTable, _at_least, _distance
from stages.errors import Obstructed, StageUsageError
from stages.way import Piece
from tests.loops import loop_over
from tests.stages.conftest import bench  # noqa: F401 - a fixture
from tracer.bodies import Rod, Sphere
from tracer.camera import Camera, look_at
from tracer.media import ConstantMedium
from tracer.scene.scene import Scene

GLASS = ConstantMedium(1.53, "glass")
SIZES = {
    "clearance_mm": 5.0, "target_size_mm": [200.0, 160.0, 20.0], "camera_radius_mm": 60.0, "camera_ahead_mm": 80.0,
    "camera_behind_mm": 150.0,
}  # fmt: skip
AXES = {
    "rail_z": Carrier("camera", "z", 500.0), "camera_x": Carrier("camera", "x"), "glass_x": Carrier("glass", "x"),
    "glass_y": Carrier("glass", "y"), "glass_z": Carrier("glass", "z"), "target_z": Carrier("target", "z"),
    "target_x": Carrier("target", "x"),
}  # fmt: skip
AT_SCENE = {name: carrier.scene_at_mm for name, carrier in AXES.items()}


def scene(gap_mm=30.0, tilt=0.0):
    place = (500.0 * np.sin(tilt), 0.0, 500.0 * np.cos(tilt))
    camera = Camera(6000.0, (1007.5, 1007.5), (2016, 2016), place, look_at(place, (0.0, 0.0, 0.0)))
    bodies = (
        Sphere("front", (0.0, 0.0, 20.0 + gap_mm), 20.0, GLASS),
        Rod("support", (0.0, -30.0, 20.0 + gap_mm), (40.0, -70.0, 25.0 + gap_mm), 6.0),
    )
    return Scene(camera, bodies)


def keep_out(gap_mm=30.0, tilt=0.0, **changes):
    return KeepOut(scene(gap_mm, tilt), AXES, KeepOutTable(**{**SIZES, **changes}))


def piece(axis, end_mm, **others):
    here = {**AT_SCENE, **others}
    return Piece(axis, here[axis], end_mm, here)


def brute_force_mm(guard, moved, draws=40_000):
    """Distances of random points of the shapes at random moments of the piece; never smaller than the truth."""
    rng, smallest = np.random.default_rng(1), np.inf
    carrier = AXES[moved.axis]
    shift = {"camera": np.zeros(3), "glass": np.zeros(3), "target": np.zeros(3)}
    for name, at_mm in moved.others_mm.items():
        if name != moved.axis:
            shift[AXES[name].element]["xyz".index(AXES[name].along)] += at_mm - AXES[name].scene_at_mm
    for one in guard._shapes:
        for other in guard._shapes:
            if one.element != carrier.element or other.element == carrier.element:
                continue
            moment = rng.random(draws)
            travel = np.zeros((draws, 3))
            way_mm = moved.start_mm + moment * (moved.end_mm - moved.start_mm) - carrier.scene_at_mm
            travel[:, "xyz".index(carrier.along)] = way_mm
            points = []
            for shape in (one, other):
                coefficients = rng.random((draws, len(shape.edges_mm)))
                coefficients = np.where(rng.random(coefficients.shape) < 0.3, np.round(coefficients), coefficients)
                points.append(shape.start_mm + coefficients @ shape.edges_mm + shift[shape.element])
            apart = np.linalg.norm(points[0] + travel - points[1], axis=1) - one.radius_mm - other.radius_mm
            smallest = min(smallest, apart.min())
    return smallest


@loop_over("seed", range(12))
def test_closest_approach_agrees_with_brute_force(seed):
    rng = np.random.default_rng(seed)
    guard = keep_out(tilt=rng.uniform(-0.3, 0.3))
    axis = rng.choice(list(AXES))
    others = {name: at + rng.uniform(-40.0, 40.0) for name, at in AT_SCENE.items()}
    moved = Piece(str(axis), others[axis], others[axis] + rng.uniform(-300.0, 300.0), others)
    exact_mm, sampled_mm = guard.closest_mm([moved]), brute_force_mm(guard, moved)
    assert exact_mm <= sampled_mm + 1e-9
    assert sampled_mm - exact_mm < 12.0


@loop_over("seed", range(60))
def test_what_is_judged_by_lengths_alone_is_judged_as_by_solving(seed, monkeypatch):
    rng = np.random.default_rng((1, seed))
    guard = keep_out(gap_mm=rng.uniform(0.0, 60.0), clearance_mm=rng.uniform(0.1, 60.0))
    axis = str(rng.choice(list(AXES)))
    others = {name: at + rng.uniform(-25.0, 25.0) for name, at in AT_SCENE.items()}
    moved = Piece(axis, others[axis], others[axis] + rng.uniform(-80.0, 80.0), others)

    def judged():
        try:
            guard.check([moved])
        except Obstructed as refused:
            return str(refused)
        return "free"

    quickly, found = judged(), list(guard.overlaps())
    with monkeypatch.context() as patched:
        patched.setattr("daq.bench.keep_out._at_least", lambda *_: -np.inf)
        assert judged() == quickly
        assert list(guard.overlaps()) == found


def test_no_distance_is_shorter_than_what_its_shadows_say():
    rng = np.random.default_rng(7)
    for _ in range(200):
        gap, plus, minus = rng.normal(0.0, 2.0, 3), rng.normal(size=(3, 3)), rng.normal(size=(2, 3))
        assert _at_least(gap, plus, minus) <= _distance(gap, plus, minus) + 1e-9


def test_what_is_far_apart_is_not_solved_for(mocker):
    guard = keep_out()
    mocker.patch("daq.bench.keep_out._distance", side_effect=AssertionError("solved"))
    guard.check([piece("rail_z", 495.0)])
    guard.check([piece("glass_z", -12.5)])  # the board is wider than the ball is far from it
    assert not list(guard.overlaps())


def test_who_has_no_walls_solves_for_none(mocker):
    """Each bench file, and each plan on it, makes such a guard: what it asks, `check` asks a dozen times."""
    mocker.patch("daq.bench.keep_out._distance", side_effect=AssertionError("solved"))
    keep_out()


def test_distances_one_can_work_out_by_hand():
    guard = keep_out()
    # sphere of radius 20 at z = 50: its pole is 30 mm before the plane
    assert guard.closest_mm([piece("glass_z", 0.0)]) == pytest.approx(30.0, abs=1e-6)
    assert guard.closest_mm([piece("glass_z", -12.5)]) == pytest.approx(17.5, abs=1e-6)
    assert guard.closest_mm([piece("target_z", 8.0)]) == pytest.approx(22.0, abs=1e-6)
    # the lens ends at z = 420 with a hemisphere of radius 60, the sphere at z = 70
    assert guard.closest_mm([piece("rail_z", 300.0)]) == pytest.approx(500 - 80 - 60 - 70 - 200, abs=1e-6)


def test_a_way_through_is_seen_although_both_ends_are_free():
    """From the left of the target to its right, level with it."""
    guard = keep_out()
    beside = {"glass_z": -60.0, "glass_x": -160.0}  # left of the target, level with it
    across = piece("glass_x", 160.0, **beside)
    with pytest.raises(Obstructed, match=r"glass_x from -160 to 160 mm would bring .* from the target"):
        guard.check([across])
    keep_away = piece("glass_x", -170.0, **beside)
    guard.check([keep_away])


def test_clearance_is_kept_and_what_is_too_close_may_only_go_away():
    guard = keep_out()
    guard.check([piece("glass_z", -24.9)])
    with pytest.raises(Obstructed, match=r"bring front to 4\.90 mm from the target; allowed are 5 mm"):
        guard.check([piece("glass_z", -25.1)])
    guard.check([piece("glass_z", 0.0, glass_z=-27.0)])
    guard.check([piece("glass_x", 10.0, glass_z=-27.0)])  # along the target: not closer
    with pytest.raises(Obstructed):
        guard.check([piece("glass_z", -27.5, glass_z=-27.0)])


def test_contact_is_legal_where_the_file_says_so():
    free, contact = keep_out(gap_mm=0.0), keep_out(gap_mm=0.0, contact=["front"])
    touching = piece("glass_z", 0.0, glass_z=10.0)
    with pytest.raises(Obstructed):
        free.check([touching])
    contact.check([touching])
    contact.check([piece("target_z", 0.02)])
    with pytest.raises(Obstructed, match="front"):
        contact.check([piece("target_z", 0.05)])
    with pytest.raises(Obstructed, match="the camera"):  # contact with the target does not license the lens
        contact.check([piece("rail_z", 100.0)])
    with pytest.raises(StageUsageError, match="no body nobody"):
        keep_out(contact=["nobody"])


def test_a_packed_bed_is_judged_quickly(benchmark_s):
    bodies = tuple(
        Sphere(f"s{i}{j}", (10.0 * i - 45.0, 10.0 * j - 45.0, 40.0), 5.0, GLASS)
        for i in range(10)
        for j in range(10)
    )
    bed = Scene(scene().camera, bodies)
    guard = KeepOut(bed, AXES, KeepOutTable(**SIZES))
    assert benchmark_s(lambda: guard.check([piece("glass_x", 20.0)])) < 2.0


@pytest.fixture
def benchmark_s():
    def run(action):
        begun_s = time.process_time()
        action()
        return time.process_time() - begun_s

    return run


def test_a_guarded_stage_does_not_move(bench):  # noqa: F811 - the same
    made = bench("zaber_ascii", carries="glass", along="z", limits_mm=[0.0, 120.0], approach=None)
    carriers = {"a": Carrier("glass", "z", 60.0), "b": Carrier("target", "z", 60.0)}
    made.stage.guard = KeepOut(scene(), carriers, KeepOutTable(**SIZES))
    made.stage.home()
    with pytest.raises(Obstructed):  # homing is not judged; now the glass stands behind the plane
        made.stage.move({"b": 110.0})
    made.stage.guard = None
    made.stage.move({"a": 60.0, "b": 60.0})
    made.stage.guard = KeepOut(scene(), carriers, KeepOutTable(**SIZES))
    before_mm = made.world.true_mm("a"), made.world.true_mm("b")
    with pytest.raises(Obstructed, match="b from 60"):
        made.stage.move({"a": 50.0, "b": 76.0})  # 10 down, 16 up: 4 mm are left
    assert (made.world.true_mm("a"), made.world.true_mm("b")) == before_mm
    made.stage.move({"a": 50.0, "b": 74.0})


def test_contact_with_the_board_is_no_licence_to_touch_the_camera():
    """The board hangs far behind, so that only lens and ball are near each other."""
    away = {"target_z": -300.0}
    contact = keep_out(gap_mm=0.0, contact=["front"])
    contact.check([piece("rail_z", 186.0, **away)])  # 80 mm of lens, its radius of 60 and a ball of 40: 6 are left
    for end_mm in (184.0, 180.1):
        with pytest.raises(Obstructed, match="front"):
            contact.check([piece("rail_z", end_mm, **away)])
