"""A flow whose laser and camera another program triggers: whole pairs, and what nothing here has checked."""

import html
import random
import re
import threading

import pytest

from daq.bench.bench_file import load_bench
from daq.bench.pairs_section import PairsSection
from daq.cameras.frame import FrameMeta
from daq.errors import CameraTimeout, PlanError, RunInterrupted, RunUsageError
from daq.plans.plan import load_plan
from daq.runner.interrupts import Interrupts
from daq.runner.pair_finder import PairFinder
from daq.runner.pair_source import PairSource, require_rate_seen
from daq.runs.frame_accounting import UNCHECKED
from daq.runs.pairs import pairs_of
from daq.runs.run_check import check_run
from daq.runs.run_folder import RunFolder
from ground.errors import ConfigError
from rtpiv.analysis.report.page import Page
from rtpiv.analysis.report.run import account_chapter
from rtpiv.command_line.cli import DONE, main
from sim import world
from sim.timing import SimulatedTiming
from tests.daq.cameras.rigs import need_harvesters
from tests.daq.flow_bench import ToldLight, acquire_simulated, write_flow
from tests.daq.runner.test_flow_step import chunks, judge


@pytest.fixture(autouse=True)
def told_light(monkeypatch):
    need_harvesters()
    monkeypatch.setattr(world, "LitFlow", ToldLight)
    # The world keeps pace with the wall while pulses come: only once the camera waits, or homing takes 30 s.
    is_awaited, triggers, arm = threading.Event(), SimulatedTiming.triggers_camera.fget, PairSource.arm
    paced = property(lambda unit: is_awaited.is_set() and triggers(unit))
    monkeypatch.setattr(SimulatedTiming, "triggers_camera", paced)
    monkeypatch.setattr(PairSource, "arm", lambda self: (is_awaited.set(), arm(self)))


def write_foreign(folder, shape="two_blocks", rate_hz=25.0, dt_us=100.0, plan_more="", **changes):
    """A flow bench without its timing unit, beside a synchroniser that runs all the time."""
    bench, plan = write_flow(folder, shape=shape, **changes)
    text = re.sub(r"^devices:\n(  .*\n)+", "", bench.read_text(), flags=re.MULTILINE)
    table = f"  synchroniser: {{rate_hz: {rate_hz}, dt_us: {dt_us}}}\n"
    bench.write_text(text.replace("simulation:\n", f"simulation:\n{table}"))
    plan.write_text(plan.read_text().replace("laser: laser\n", "") + plan_more)
    return bench, plan


def run(folder, **changes):
    bench, plan = write_foreign(folder, **changes)
    return acquire_simulated(plan, bench, folder / "runs", operator=None)


@pytest.mark.slow
@pytest.mark.parametrize(("shape", "faults"), [
    ("two_blocks", "first_skipped: 3, skipped: [19], dropped: [30]"),
    pytest.param("straddling", "", marks=pytest.mark.slow),
    pytest.param("double_height", "", marks=pytest.mark.slow),
])  # fmt: skip
def test_pairs_of_another_programs_pulses_are_whole(tmp_path, capsys, shape, faults):
    dt_us = 19_700.0 if shape == "straddling" else 100.0
    path = run(
        tmp_path, shape=shape, dt_us=dt_us, faults=faults, pairs=14, chunk=8, plan_more="lost_at_most: 0.9\n"
    )
    found = judge(path, 14)
    assert {round(1e6 * pair.dt_s, 6) for pair in found.pairs} == {dt_us}
    assert check_run(path).is_sound
    assert [chunk["synchroniser"] for chunk in chunks(path)] == ["external"] * 2
    said = " ".join(capsys.readouterr().out.split())
    assert said.count(UNCHECKED) == 2, "before the run and behind it"
    assert "triggered from outside in 2 chunks: 14 are kept" in said
    assert "Ctrl-C switches the laser off" not in said
    page = Page("a flow")
    account_chapter(page, RunFolder.open(path))
    assert html.escape(UNCHECKED[1:]) in page.html()


@pytest.mark.parametrize("lost", [0.0, 0.15, 0.4])
@pytest.mark.parametrize("counts_lost", [True, False])
def test_a_rate_is_told_by_frames_though_a_busy_computer_loses_some(lost, counts_lost):
    """At twice the rate the pairs whose neighbours are lost come at the rate of the plan."""
    rng = random.Random(7)
    section = PairsSection(shape="two_blocks", marker="line_status", line=1, dead_us=100.0)
    for share in (0.5, 0.97, 1.0, 1.03, 2.0, 3.0):
        finder = PairFinder(section, 25.0, 500.0, lambda item: None)
        sequence = 0
        for pulse in range(60):
            for second in (False, True):
                is_lost = rng.random() < lost
                sequence += not is_lost or counts_lost
                at_ns = 10**9 + round(pulse * 4e7 / share) + 500_000 * second
                meta = FrameMeta(
                    sequence,
                    sequence,
                    at_ns,
                    at_ns,
                    400.0,
                    "Mono12",
                    12,
                    chunks={"LineStatusAll": 0 if second else 2},
                )
                if not is_lost:
                    finder.add(meta, None)
        if share == 1.0:
            require_rate_seen(finder.periods_ns, 25.0)
            continue
        with pytest.raises(RunUsageError, match=f"triggers {25 * share:.4g} pairs/s .* says rate_hz: 25"):
            require_rate_seen(finder.periods_ns, 25.0)
    require_rate_seen(finder.periods_ns[:3], 25.0)  # too few to tell


def test_what_is_not_checked_is_said_before_a_run_by_check_and_in_the_report(tmp_path, capsys):
    bench, plan = write_foreign(tmp_path, pairs=4)
    assert main(["check", str(plan), "--bench", str(bench)]) == DONE
    assert UNCHECKED in " ".join(capsys.readouterr().out.split())
    assert main(["acquire", str(plan), "--bench", str(bench), "--dry-run", "--home"]) == DONE
    assert UNCHECKED in " ".join(capsys.readouterr().out.split())


def test_a_dt_that_the_exposures_cannot_hold_is_refused_before_anything_moves(tmp_path):
    bench, plan = write_foreign(tmp_path)
    plan.write_text(plan.read_text().replace("dt_us: 100.0", "dt_us: 3.0"))
    with pytest.raises(Exception, match="does not fit into the two exposures"):
        load_plan(plan, load_bench(bench))


def test_a_bench_with_a_timing_unit_needs_its_name(tmp_path):
    bench, plan = write_flow(tmp_path)
    plan.write_text(plan.read_text().replace("laser: laser\n", ""))
    with pytest.raises(PlanError, match=r"names no laser, and the bench has laser; name it \(laser: laser\)"):
        load_plan(plan, load_bench(bench))


def test_a_warm_up_belongs_to_a_laser(tmp_path):
    bench, plan = write_foreign(tmp_path, plan_more="warm_up_s: 5.0\n")
    with pytest.raises(ConfigError, match="warm_up_s belongs to a laser"):
        load_plan(plan, load_bench(bench))


@pytest.mark.slow
@pytest.mark.parametrize("rate_hz", [12.5, 24.0, 50.0])
def test_a_synchroniser_at_another_rate_than_the_plans_is_found(tmp_path, rate_hz):
    with pytest.raises(RunUsageError, match=f"triggers {rate_hz:.4g} pairs/s by the camera's clock"):
        run(tmp_path, rate_hz=rate_hz, pairs=6, chunk=6)


@pytest.mark.slow
def test_a_synchroniser_that_ends_leaves_a_run_that_goes_on(tmp_path, monkeypatch):
    start, hand_over, units = SimulatedTiming.start, PairSource.hand_over, []

    def keep(self, chunk, pair):
        if chunk.kept == 4:
            units[-1].firmware.person_stops()
        return hand_over(self, chunk, pair)

    monkeypatch.setattr(SimulatedTiming, "start", lambda self: (units.append(self), start(self)))
    monkeypatch.setattr(PairSource, "hand_over", keep)
    with pytest.raises(CameraTimeout, match="look at the camera's trigger"):
        run(tmp_path, pairs=100, chunk=100)
    monkeypatch.undo()
    (path,) = (tmp_path / "runs").glob("*_plan-flow")
    assert 4 < len(pairs_of(path).pairs) < 100


@pytest.mark.slow
def test_the_wait_for_the_first_trigger_ends_on_request(tmp_path, monkeypatch):
    bench, plan = write_foreign(tmp_path)
    bench.write_text(re.sub("  synchroniser: .*\n", "", bench.read_text()))
    told = []

    def ask_for_the_end(self):
        threading.Timer(1.0, lambda: setattr(self, "_presses", 1)).start()
        told.append(True)
        return enter(self)

    enter = Interrupts.__enter__
    monkeypatch.setattr(Interrupts, "__enter__", ask_for_the_end)
    with pytest.raises(RunInterrupted, match="ended on request"):
        acquire_simulated(plan, bench, tmp_path / "runs", operator=None)
    assert told
