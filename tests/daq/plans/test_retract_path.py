"""A homed place that obstructs: the lens stands within the clearance of the glass, which retracts first."""

import pytest

from daq.bench.bench_file import load_bench
from daq.bench.bench_session import BenchSession
from daq.bench.guards import idle_stage
from daq.plans.forecast import forecast_from_home, retract_path
from daq.plans.plan import load_plan
from daq.runner.run_camera import RunCamera
from daq.runner.runner import Runner
from daq.runner.session import Request, begin
from ground.errors import ConfigError
from rtpiv.command_line.cli import DONE, USAGE, main
from stages.errors import Obstructed
from tests.daq.small_bench import FILES_CAMERA, files_bench, write_bench, write_frames

PLAN = "experiment: shift\nviews: [glass]\ndisplacements: [{along: [1.0, 0.0, 0.0], mm: 0.5}]\n"
HOMED_AT_MM = {
    "rail_z": -200.0, "camera_x": 0.0, "camera_y": 0.0, "glass_x": -5.0, "glass_y": 0.0, "glass_z": -2.0,
    "target_x": 0.0, "target_y": 0.0, "target_z": -22.5,
}  # fmt: skip


def obstructed_bench(folder, after_home=None, homed_at_mm=None):
    """The example bench, its camera and glass homed before each other: 1.7 mm apart where 2 mm are to be kept."""
    path = write_bench(folder, camera=FILES_CAMERA)
    text = path.read_text()
    for old, new, times in (
        ("offset_mm: 100.0", "offset_mm: 1.0", 2),
        (
            "offset_mm: -75.0,\n       limits_mm: [-70.0, 70.0]",
            "offset_mm: -5.0,\n       limits_mm: [-4.0, 70.0]",
            1,
        ),
        ("offset_mm: -140.0", "offset_mm: 0.0", 1),
        ("camera_ahead_mm: 60.0", "camera_ahead_mm: 150.5", 1),
    ):
        assert text.count(old) == times
        text = text.replace(old, new)
    if after_home is not None:
        text = text.replace("  home_order:", f"  after_home: {after_home}\n  home_order:")
    for name, mm in (homed_at_mm or {}).items():
        text = text.replace(f"    {name}:\n      {{", f"    {name}:\n      {{homed_at_mm: {mm}, ")
    path.write_text(text)
    (folder / "plan.yaml").write_text(PLAN)
    bench = load_bench(path)
    return bench, load_plan(folder / "plan.yaml", bench)


def run(folder, bench, plan):
    write_frames(folder / "frames_in", 8)
    run_folder = begin(Request(bench.path, plan.path, correct=False), bench, plan, folder / "runs")
    with files_bench(bench, folder / "frames_in") as hardware:
        before_mm = hardware.simulation.true_mm()
        try:
            Runner(hardware, [RunCamera(hardware, run_folder)], plan.steps).run()
        except Obstructed:
            assert hardware.simulation.true_mm() == before_mm
            raise
    return run_folder


def test_without_a_way_out_there_is_none_and_the_error_says_what_to_write(tmp_path):
    bench, plan = obstructed_bench(tmp_path)
    with pytest.raises(Obstructed, match=r"1\.66 mm apart already.*after_home"):
        run(tmp_path, bench, plan)


def test_a_stated_way_out_is_driven_after_homing(tmp_path):
    bench, plan = obstructed_bench(tmp_path, "[{rail_z: -20.0}, {rail_z: 0.0}]")
    assert run(tmp_path, bench, plan).is_done


def test_a_way_out_that_comes_closer_is_refused(tmp_path):
    bench, _ = obstructed_bench(tmp_path, "[{glass_z: 10.0}, {rail_z: 0.0}]")
    with BenchSession(bench, simulate=True) as session:
        with pytest.raises(Obstructed, match=r"move 1 of after_home: glass_z"):
            session.home()
        assert session.where()["rail_z"] == pytest.approx(-200.0, abs=0.01)
        assert session.move(rail_z=0.0)["rail_z"].measured_mm == pytest.approx(0.0, abs=0.01)


def test_homing_one_axis_does_not_drive_the_others(tmp_path):
    bench, _ = obstructed_bench(tmp_path, "[{rail_z: 0.0}]")
    with BenchSession(bench, simulate=True) as session:
        session.home("rail_z")
        assert session.where()["rail_z"] == pytest.approx(-200.0, abs=0.01)
        session.home(*bench.table.stages.axes)
        assert session.where()["rail_z"] == pytest.approx(0.0, abs=0.01)


def test_the_dry_run_judges_the_way_out_where_the_homed_place_is_stated(tmp_path):
    bench, plan = obstructed_bench(tmp_path, None, HOMED_AT_MM)
    said, sentence = forecast_from_home(bench, idle_stage(bench), plan.steps)
    assert "judged from the homed place" in sentence
    assert "glass_z from -2 to 30.5" in said.violations[0].text
    bench, plan = obstructed_bench(tmp_path / "out", "[{rail_z: 0.0}]", HOMED_AT_MM)
    said, sentence = forecast_from_home(bench, idle_stage(bench), plan.steps)
    assert "left by after_home" in sentence
    assert said.violations == ()
    bench, plan = obstructed_bench(tmp_path / "closer", "[{glass_z: 10.0}]", HOMED_AT_MM)
    said, sentence = forecast_from_home(bench, idle_stage(bench), plan.steps)
    assert "does not lead out" in sentence
    assert said.violations[0].tag == "move 1 of after_home"


def test_what_is_not_stated_is_not_judged_and_said_so(tmp_path):
    known = {name: mm for name, mm in HOMED_AT_MM.items() if name != "target_z"}
    bench, plan = obstructed_bench(tmp_path, "[{glass_z: 10.0}]", known)
    said, sentence = forecast_from_home(bench, idle_stage(bench), plan.steps)
    assert "note: where homing leaves target_z is not stated (homed_at_mm)" in sentence
    assert said.violations == ()  # forecast from the place of the scene, as without homing
    out = retract_path(obstructed_bench(tmp_path / "moved", "[{target_z: 0.0}]", known)[0], idle_stage(bench))
    assert out.start_mm == {**HOMED_AT_MM, "target_z": 0.0}


def test_stated_places_are_those_of_the_simulated_bench(tmp_path):
    bench, _ = obstructed_bench(tmp_path, None, HOMED_AT_MM)
    with BenchSession(bench, simulate=True) as session:
        assert session.home() == pytest.approx(HOMED_AT_MM, abs=0.01)


def test_acquire_home_obeys_and_refuses_before_anything_opens(tmp_path, capsys):
    bench, plan = obstructed_bench(tmp_path, "[{glass_z: 10.0}]", HOMED_AT_MM)
    files = [str(plan.path), "--bench", str(bench.path), "-o", str(tmp_path / "runs"), "--home"]
    assert main(["acquire", *files]) == USAGE
    assert "move 1 of after_home" in capsys.readouterr().err
    assert not (tmp_path / "runs").exists()
    obstructed_bench(tmp_path, "[{rail_z: 0.0}]", HOMED_AT_MM)
    assert main(["acquire", *files, "--dry-run"]) == DONE
    assert "left by after_home" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("after_home", "sentence"),
    [
        ("[{rail_q: 0.0}]", "after_home names an unknown axis 'rail_q'"),
        ("[{rail_z: 1701.0}]", "rail_z 1701 mm is outside its limits"),
        ("[{}]", "after_home"),
        ("{rail_z: 0.0}", "after_home"),
    ],
)
def test_what_makes_no_sense_is_refused_with_its_line(tmp_path, after_home, sentence):
    with pytest.raises(ConfigError, match=sentence):
        obstructed_bench(tmp_path, after_home)
