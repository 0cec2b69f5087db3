"""What a plan notes of what was going on: kept with the run, shown by its pages, and read by nothing else."""

import pytest

from daq.bench.bench_file import load_bench
from daq.plans.plan import load_plan, read_plan
from daq.runs.run_folder import RunFolder
from daq.runs.run_views import notes_of
from ground.errors import ConfigError
from rtpiv.analysis.report.page import Page
from rtpiv.analysis.report.run import provenance_chapter
from tests.daq.small_bench import FILES_CAMERA, TARGET, write_bench
from tests.daq.small_run import about_run, planned

NOTES = "notes: {flow rate: 5.2 l/min, Re: 1200, T_C: 21.3, operator: 'Ä. <b>Ada</b>', seeded: true}\n"


def plan(folder, text):
    (folder / "plan.yaml").write_text(text)
    return folder / "plan.yaml"


def test_notes_change_no_step(tmp_path):
    bench = load_bench(write_bench(tmp_path, camera=FILES_CAMERA))
    plain = load_plan(plan(tmp_path, TARGET), bench)
    noted = load_plan(plan(tmp_path, TARGET + NOTES), bench)
    assert noted.table.notes == {
        "flow rate": "5.2 l/min", "Re": 1200, "T_C": 21.3, "operator": "Ä. <b>Ada</b>", "seeded": True,
    }  # fmt: skip
    assert noted.content_hash() == plain.content_hash()  # a run goes on though somebody has added one


@pytest.mark.parametrize(
    "notes", ["[a, b]", "{a: {b: 1}}", "{a: [1, 2]}", "{'': 1}", f"{{a: {'x' * 1001}}}", "{a: null}", "{a: .nan}"]
)
def test_what_is_no_note_is_refused_with_its_line(tmp_path, notes):
    with pytest.raises(ConfigError, match=r"plan\.yaml:\d.*(notes|not a finite number)"):
        read_plan(plan(tmp_path, f"{TARGET}notes: {notes}\n"))


def test_a_run_shows_them(tmp_path):
    folder = RunFolder.create(tmp_path, "noted", about_run([planned(0)], plan=TARGET + NOTES))
    assert notes_of(folder)["Re"] == "1200"
    page = Page("a", "b")
    provenance_chapter(page, folder, "h", [])
    page.write(tmp_path / "page.html")
    text = (tmp_path / "page.html").read_text()
    assert "Operator&#x27;s notes" in text
    assert "<dt>flow rate</dt><dd>5.2 l/min</dd>" in text
    assert "Ä. &lt;b&gt;Ada&lt;/b&gt;" in text
    assert notes_of(RunFolder.create(tmp_path, "plain", about_run([planned(0)]))) == {}
