"""Many alignments without pictures: ways judged by keep-out, and again by the witness, who knows the truth."""

import numpy as np
import pytest

from correction.alignment.moves import Look, plan_moves
from correction.alignment.seen import Arrangement
from daq.bench.bench_file import load_bench
from daq.bench.guards import idle_stage
from daq.plans.plan import load_plan
from daq.plans.steps import route
from daq.runner.alignment_loop import free_before_target_mm, guard_where_seen, next_targets
from sim.arranged import where_scene_holds
from sim.witness.clearances import Carried, Clearances
from stages.errors import StageUsageError
from tests.daq.small_bench import write_bench

SIGMA_MM, CAMERA_SIGMA_MM = (
    np.array((0.003, 0.003, 0.72)),
    np.array((0.015, 0.015, 0.004)),
)  # as of 2016 px, rendered
PLAY_MM = 0.005


@pytest.fixture(scope="module")
def bench_and_plan(tmp_path_factory):
    folder = tmp_path_factory.mktemp("clearances")
    path = write_bench(folder)
    (folder / "plan.yaml").write_text("experiment: align\n")
    bench = load_bench(path)
    return bench, load_plan(folder / "plan.yaml", bench)


def ways(bench, plan, rng):
    """Align once; return what the witness saw come too close, and where the glass ended if not refused."""
    off = rng.uniform(-1.5, 1.5, 3)
    bias = np.clip(rng.normal(), -2.5, 2.5) * SIGMA_MM * (0.5, 0.5, 1.0)
    stages, home = bench.table.stages, where_scene_holds(bench, off.tolist())
    carried = {n: Carried(a.carries, "xyz".index(a.along), home[n]) for n, a in stages.axes.items()}
    witness = Clearances(bench.scene, carried, bench.table.keep_out, dict.fromkeys(carried, PLAY_MM))
    stage, here, looks, close = idle_stage(bench), dict(bench.home_mm) | bench.table.glass.retract_mm, [], []
    for name, mm in here.items():
        witness.put(name, mm)
    targets = plan.steps[0].targets_mm
    for _ in range(4):
        for move in route(bench, here, targets):
            try:
                stage.check(here, move)
            except StageUsageError:  # said before it is made: nothing moves any more
                return close, None
            for piece in stage.way(here, move):
                witness.note_rest()
                close += witness.judge_motion({piece.axis: piece.end_mm}, {piece.axis}, {})
            here |= move
        glass = np.array(bench.table.offset_mm("glass", here))
        seen = off + glass + bias + rng.uniform(-0.5, 0.5, 3) * PLAY_MM + rng.normal(0.0, 0.002, 3)
        camera = np.array(bench.table.offset_mm("camera", here))
        arrangement = Arrangement(seen, np.diag(SIGMA_MM**2), (), camera, CAMERA_SIGMA_MM)
        looks.append(Look(glass, camera, arrangement))
        want = plan_moves(looks, {"glass": "xyz", "camera": "xyz"}, free_before_target_mm(bench))
        targets = next_targets(bench, targets, looks[-1], want)
        stage.guard = guard_where_seen(bench, want)
    return close, off + glass


def test_no_alignment_brings_glass_too_close(bench_and_plan):
    rng = np.random.default_rng(1)
    for _ in range(8):
        close, glass = ways(*bench_and_plan, rng)
        assert not close
        assert np.hypot(*glass[:2]) < 0.01


@pytest.mark.slow
@pytest.mark.timeout(3000)
def test_no_alignment_of_a_thousand_brings_glass_too_close(bench_and_plan):
    rng = np.random.default_rng(2)
    ends = []
    for _ in range(1000):
        close, glass = ways(*bench_and_plan, rng)
        assert not close
        if glass is not None:
            ends.append(glass)
    sideways = np.hypot(*np.array(ends)[:, :2].T)
    last, worst = 1e3 * np.quantile(sideways, 0.99), 1e3 * sideways.max()
    print(f"{1000 - len(ends)} refused; sideways: 99 % within {last:.1f} um, worst {worst:.1f} um")
    assert np.quantile(sideways, 0.99) < 0.01
    assert len(ends) > 980  # glass_z of this bench has 1 mm to its limit, and depth is seen to 0.7 mm


def test_the_witness_sees_what_goes_wrong(bench_and_plan):
    bench, plan = bench_and_plan
    blind = plan.steps[0].targets_mm | {"glass_z": -1.0}
    carried = {
        n: Carried(a.carries, "xyz".index(a.along), bench.home_mm[n]) for n, a in bench.table.stages.axes.items()
    }
    witness = Clearances(bench.scene, carried, bench.table.keep_out, dict.fromkeys(carried, PLAY_MM))
    assert witness.judge_motion({"glass_z": blind["glass_z"]}, {"glass_z"}, {})
