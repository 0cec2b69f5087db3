"""A gauge during a run: in journal and report; one that is needed stops it, to be resumed."""

from dataclasses import replace

import pytest

from daq.bench.bench_file import load_bench
from daq.bench.gauges import FileGauge
from daq.bench.opened import open_bench
from daq.bench.reading import ReadingSection
from daq.errors import PlanError, ReadingMissing
from daq.plans.plan import load_plan
from daq.runner.progress import Progress
from daq.runner.run_camera import RunCamera
from daq.runner.runner import Runner
from daq.runner.session import Request, begin, reopen
from daq.runs.run_views import readings_of
from rtpiv.analysis.report.page import Page
from rtpiv.analysis.report.run import provenance_chapter
from tests.daq.small_bench import FILES_CAMERA, TARGET, files_bench, load, write_bench, write_frames

SECTION = ReadingSection(unit="<l>/min", file="meter.csv")


class Logger(FileGauge):
    """A gauge to whose file another program adds a row before it is read; at some readings it does not."""

    def __init__(self, path, values):
        super().__init__(SECTION, path)
        self.path, self.values = path, list(values)

    def reading(self):
        from datetime import UTC, datetime

        if (value := self.values.pop(0)) is not None:
            with self.path.open("a") as file:
                file.write(f"{datetime.now(UTC).isoformat()},{value}\n")
        else:
            self.path.unlink(missing_ok=True)
        return super().reading()


def run(tmp_path, values, needed=(), folder=None):
    bench, plan = load(tmp_path, TARGET, camera=FILES_CAMERA)
    files = write_frames(tmp_path / "frames_in", 20)
    folder = folder or begin(Request(bench.path, plan.path, correct=False), bench, plan, tmp_path / "runs")
    said = Progress()
    with files_bench(bench, files) as hardware:
        gauge = Logger(tmp_path / "meter.csv", values)
        opened = replace(hardware, devices={**hardware.devices, "flow": gauge})
        runner = Runner(opened, [RunCamera(opened, folder)], plan.steps, needed=needed)
        said = runner.progress
        try:
            runner.run()
        except ReadingMissing:
            return folder, said, False
    return folder, said, True


def test_each_step_has_its_reading_and_a_silent_gauge_is_said_once(tmp_path):
    folder, said, _ = run(tmp_path, [5.0, None, 5.5])
    found = readings_of(folder)["flow"]
    assert [reading.get("value") for _, reading in found] == [5.0, None, 5.5]
    assert "No such file" in found[1][1]["missing"]
    assert len(said.remarks) == 1
    page = Page("a", "b")
    provenance_chapter(page, folder, "h", [])
    page.write(tmp_path / "page.html")
    text = (tmp_path / "page.html").read_text()
    assert (
        "<td>flow [&lt;l&gt;/min]</td><td>5.25</td><td>0.3536</td><td>5</td><td>5.5</td><td>2</td><td>1</td>"
        in text
    )
    assert "missing: meter.csv: No such file" in text


def test_one_that_is_needed_stops_the_run_before_a_frame_and_resume_goes_on(tmp_path):
    folder, _, ended = run(tmp_path, [5.0, None], needed=["flow"])
    assert not ended
    assert not folder.is_done
    assert [entry["step"] for entry in folder.entries() if entry["kind"] == "frame"] == [0]
    _, _, ended = run(tmp_path, [5.1, 5.2], needed=["flow"], folder=reopen(folder.path).folder)
    assert ended
    assert [reading["value"] for _, reading in readings_of(folder)["flow"]] == [5.0, 5.1, 5.2]


def test_a_plan_may_need_only_what_the_bench_has(tmp_path):
    path = write_bench(tmp_path, camera=FILES_CAMERA)
    (tmp_path / "plan.yaml").write_text(f"{TARGET}needed: [flow]\n")
    with pytest.raises(PlanError, match="the bench has no reading 'flow'"):
        load_plan(tmp_path / "plan.yaml", load_bench(path))
    path.write_text(path.read_text() + "devices:\n  flow: {kind: reading, unit: l/min, file: meter.csv}\n")
    assert load_plan(tmp_path / "plan.yaml", load_bench(path)).table.needed == ["flow"]


def test_a_simulated_bench_has_a_meter_in_its_place(tmp_path):
    path = write_bench(tmp_path)
    path.write_text(path.read_text() + "devices:\n  flow: {kind: reading, unit: l/h, file: meter.csv}\n")
    with open_bench(load_bench(path), True, only={"flow"}) as hardware:
        reading = hardware.devices["flow"].reading()
    assert (reading.unit, reading.missing) == ("l/h", "")
    assert reading.value == pytest.approx(5.2, rel=0.011)
