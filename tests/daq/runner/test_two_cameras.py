"""Two cameras take the pairs of one flow: whatever either loses, frames of one number show one trigger."""

import re
from dataclasses import replace
from types import SimpleNamespace

import pytest
import tifffile

from daq.bench.bench_file import load_bench
from daq.bench.pairs_section import PairsSection
from daq.cameras.frame import FrameMeta
from daq.errors import FrameDoubt, PlanError, RunUsageError
from daq.live import live_page
from daq.live.live_page import RateLimiter
from daq.live.run_shown import words_of
from daq.plans.plan import load_plan
from daq.plans.pulse_order import PulseOrder
from daq.runner import flow_step, pair_writer
from daq.runner.clock_calibration import Shot
from daq.runner.flow_step import FlowStep
from daq.runner.pair_source import Chunk, PairSource
from daq.runner.progress import Progress
from daq.runs.clock_map import clock_maps
from daq.runs.frame_accounting import ELSEWHERE, FrameAccounting
from daq.runs.pairs import pairs_of
from daq.runs.run_check import check_run
from daq.runs.run_folder import RunFolder, frame_entries
from ground.errors import ConfigError
from rtpiv.verbs.check import check
from rtpiv.verbs.resume import resume
from sim import world
from tests.daq.cameras.rigs import need_aravis, need_harvesters
from tests.daq.flow_bench import DIODES, ToldLight, acquire_simulated, told, write_flow


@pytest.fixture(autouse=True)
def told_light(monkeypatch):
    need_harvesters()
    monkeypatch.setattr(world, "LitFlow", ToldLight)


def write_two(folder, backend="harvesters", faults="", further="", changes=("", ""), **more):
    """A bench with a second camera `behind`, and a plan that asks for both."""
    path, plan = write_flow(folder, channels=DIODES, faults=faults, **more)
    text = path.read_text()
    camera = re.search(r"^camera:\n((?:  .*\n)+)", text, re.MULTILINE).group(1)
    lines = "".join(f"  {line}\n" for line in camera.replace("harvesters", backend).splitlines())
    scene = (folder / "scene.yaml").read_text()
    side = re.search(r"sensor_px: \[(\d+)", scene).group(1)
    (folder / "scene_behind.yaml").write_text(scene.replace(f"[{side}, {side}]", f"[{int(side) - 16}, {side}]"))
    behind = f"  behind:\n    kind: camera\n    scene: scene_behind.yaml\n{lines}".replace(*changes)
    text = text.replace("simulation:\n", f"simulation:\n  cameras: {{behind: {{clock_ppm: 50.0{further}}}}}\n")
    path.write_text(text.replace("devices:\n", f"devices:\n{behind}"))
    plan.write_text(plan.read_text() + "cameras: [behind]\n")
    return path, plan


def run(folder, live=False, **changes):
    bench, plan = write_two(folder, **changes)
    return acquire_simulated(plan, bench, folder / "runs", live=live)


def judge(path, pairs):
    """Both are whole runs, and every frame shows the same pulse of the same pair as the other camera's."""
    beside = path / "cameras" / "behind"
    for folder in (path, beside):
        found = check_run(folder)
        assert found.is_sound, found.findings
        assert found.is_done
        assert (len(pairs_of(folder).pairs), pairs_of(folder).alone) == (pairs, ())
    shown = []
    for number in range(2 * pairs):
        first, second = (tifffile.imread(folder / "frames" / f"{number:06d}.tif") for folder in (path, beside))
        assert told(first) == told(second)
        assert first.shape[1] == second.shape[1] + 16  # each its own sensor
        shown.append(told(first)[1:])
    assert shown == sorted(set(shown))
    return beside


def books(path):
    return [entry for entry in RunFolder.open(path).entries() if entry["kind"] == "chunk"]


class Page:
    """A page without a server."""

    url, is_due = "http://127.0.0.1/", True

    def __init__(self, most_bytes, port, scene, board):
        self.scene, self.shown, self.rate_limiter = scene, [], RateLimiter()
        PAGES.append(self)

    def __enter__(self):
        return self

    def __exit__(self, *error):
        pass

    def say(self, text):
        pass

    def show(self, words, pictures):
        self.shown.append((words, pictures["raw"].shape))


PAGES = []


@pytest.mark.slow
@pytest.mark.parametrize("backend", ["harvesters", pytest.param("aravis", marks=pytest.mark.slow)])
def test_what_either_loses_is_lost_for_both(tmp_path, capsys, monkeypatch, backend):
    if backend == "aravis":
        need_aravis()
    monkeypatch.setattr(live_page, "LivePage", Page)
    PAGES.clear()
    path = run(
        tmp_path, live=True, pairs=16, chunk=8, backend=backend, faults="dropped: [5]", more="lost_at_most: 0.8\n",
        further=", faults: {dropped: [8], skipped: [12], first_skipped: 2}",
    )  # fmt: skip
    beside = judge(path, 16)
    for page, name in zip(PAGES, ("", ", behind"), strict=True):
        assert {words["run"].partition(":")[0] for words, _ in page.shown} == {path.name + name}
        assert {shape for _, shape in page.shown} == {page.scene.camera.shape}
    lines = [books(path), books(beside)]
    for mine, its in zip(*lines, strict=True):
        assert (mine["fired"], mine["pairs"], mine["surplus"]) == (its["fired"], its["pairs"], its["surplus"])
        for chunk in (mine, its):
            assert (
                2 * chunk["triggers"] == 2 * chunk["pairs"] + sum(chunk["dropped"].values()) + chunk["never_came"]
            )
    assert all(sum(chunk["dropped"].get(ELSEWHERE, 0) for chunk in chunks) >= 2 for chunks in lines)
    about = RunFolder.open(path).about
    assert about["cameras"] == ["behind"]
    (fast,) = clock_maps(RunFolder.open(beside).entries())
    assert fast.drift_ppm == pytest.approx(-50.0, abs=6.0 * fast.drift_sigma_ppm)
    assert (path / "truth_behind.yaml").is_file()
    capsys.readouterr()
    check(path)
    said = capsys.readouterr().out
    assert "cameras/behind" in said.replace("\n", "")
    (beside / "frames" / "000003.tif").unlink()
    with pytest.raises(Exception, match="behind"):
        check(path)


def test_each_page_has_the_account_of_its_camera():
    progress = Progress(frames=2)
    progress.of("behind").accounting = FrameAccounting(triggered=3, missing=3)
    progress.of("behind").waiting = (7, 0)
    for camera, lost, waits in (("camera", ["0", False], ["0", False]), ("behind", ["3", True], ["7", True])):
        counters = words_of(progress, camera)["counters"]
        assert (counters["lost or incomplete"], counters["waiting for the disk"]) == (lost, waits)


@pytest.mark.slow
def test_a_run_that_was_cut_off_goes_on_with_both(tmp_path, monkeypatch):
    """Killed when one camera's pair was given to the disk and the other's was not."""
    bench, plan = write_two(tmp_path, pairs=8, chunk=4)
    keep, count = pair_writer.PairWriter.keep, 0

    def cut_off(self, *arguments):
        nonlocal count
        count += 1
        if count == 6:  # the second camera's third pair
            raise OSError("as if somebody pulled the plug")
        keep(self, *arguments)

    monkeypatch.setattr(pair_writer.PairWriter, "keep", cut_off)
    with pytest.raises(OSError, match="pulled the plug"):
        acquire_simulated(plan, bench, tmp_path / "runs")
    (path,) = (tmp_path / "runs").glob("*_plan-flow")
    present = [len(frame_entries(RunFolder.open(each).entries())) for each in (path, path / "cameras" / "behind")]
    assert present == [6, 4]
    monkeypatch.setattr(pair_writer.PairWriter, "keep", keep)
    resume(path, home=True, operator="test")
    beside = judge(path, 8)
    discarded = [e["frames"] for e in RunFolder.open(path).entries() if e["kind"] == "discard"]
    assert discarded == [[4, 5]]
    scene = tmp_path / "scene_behind.yaml"
    (beside / "done.json").unlink()
    (path / "done.json").unlink()
    scene.write_text(scene.read_text().replace("L_mm: 500.0", "L_mm: 501.0"))
    with pytest.raises(Exception, match="further cameras is another"):
        resume(path, home=True, operator="test")


class Source:
    """A camera whose clock is right."""

    def __init__(self, name, said):
        self.name, self.exposures, self.said = name, self, said
        self.dropped = 0

    def host_ns(self, pair):
        return pair[0].timestamp_ns

    def drop(self, chunk, why, *frames):
        chunk.dropped[why] += len(frames)

    def raise_ambiguity(self, said):
        raise FrameDoubt(said)


SECTION = PairsSection(shape="two_blocks", marker="spacing", dead_us=2.0)
META = FrameMeta(0, 0, 0, 0, 1.0, "Mono8", 8)


def matched(*times_ms, rate_hz=10.0):
    sources = [Source(f"camera {number}", []) for number in range(len(times_ms))]
    chunks = [Chunk(9) for _ in times_ms]

    def stream(times):
        for ms in times:
            yield None
            yield (replace(META, timestamp_ns=round(1e6 * ms)), None)

    found = flow_step.synchronise_pairs(sources, [stream(times) for times in times_ms], chunks, rate_hz)
    pairs = [tuple(pair[0].timestamp_ns / 1e6 for pair in pairs) for pairs in found]
    return pairs, [chunk.dropped[ELSEWHERE] for chunk in chunks]


@pytest.mark.parametrize(("times", "pairs", "dropped"), [
    (([0, 100, 200], [1, 101, 201]), 3, [0, 0]),
    (([0, 100, 200], [101, 201]), 2, [2, 0]),
    (([0, 100], [1, 101, 201, 301]), 2, [0, 4]),
    (([0, 200, 400], [101, 301, 501]), 0, [6, 6]),
    (([0, 100, 300], [1, 201, 301], [100, 200, 302]), 1, [4, 4, 4]),
    (([], [1, 2]), 0, [0, 4]),
])  # fmt: skip
def test_pairs_are_put_together_by_time_alone(times, pairs, dropped):
    found, gone = matched(*times)
    assert (len(found), gone) == (pairs, dropped)
    assert all(max(each) - min(each) <= 25.0 for each in found)


@pytest.mark.parametrize("off_ms", [30, 50, 74, -50])
def test_clocks_that_put_a_trigger_between_two_are_not_believed(off_ms):
    with pytest.raises(FrameDoubt, match=rf"{abs(off_ms)}.0 ms beside"):
        matched([100, 200], [100 + off_ms, 200 + off_ms])


@pytest.mark.parametrize(("changes", "words"), [
    (("ExposureTime: 400.0", "ExposureTime: 300.0"), "give them the same ExposureTime"),
    (("dead_us: 2.0", "dead_us: 3.0"), "give them the same dead_us"),
    (("line_status, line: 2", "line_status"), "marker line_status needs line"),
    (("scene_behind.yaml", "scene_nowhere.yaml"), "scene_nowhere.yaml"),
    (("TriggerSource: Line1", "TriggerSource: Software"), "triggered by the timing unit"),
])  # fmt: skip
def test_a_second_camera_that_cannot_take_the_same_pairs_is_refused(tmp_path, changes, words):
    bench, plan = write_two(tmp_path, changes=changes)
    with pytest.raises((PlanError, ConfigError), match=words):
        load_plan(plan, load_bench(bench))


def test_a_camera_that_is_not_there_is_named(tmp_path):
    bench, plan = write_two(tmp_path)
    plan.write_text(plan.read_text().replace("[behind]", "[above]"))
    with pytest.raises(PlanError, match="there is no camera 'above'; there are camera, behind"):
        load_plan(plan, load_bench(bench))
    plan.write_text(plan.read_text().replace("[above]", "[behind, behind]"))
    with pytest.raises(ConfigError, match="names a camera twice"):
        load_plan(plan, load_bench(bench))


def test_what_the_second_camera_cannot_take_is_refused_before_anything_is_fired():
    laser = SimpleNamespace(most_pairs=100)
    light = SimpleNamespace(prepare=lambda order, settings, tell: laser)
    exposures = SimpleNamespace(
        settings={"ResultingFrameRate": 30.0}, section=SimpleNamespace(buffers=48), verify=lambda: None
    )
    sides = [
        SimpleNamespace(
            whole_pairs=lambda step: 4, chunks_so_far=lambda step: 0, cut_to=lambda step, place: None,
            require_same_exposure=lambda: None,
            source=SimpleNamespace(name=name, section=SECTION, exposures=exposures, begin_step=lambda: None),
        )
        for name in ("camera", "behind")
    ]  # fmt: skip
    step = SimpleNamespace(pulses=PulseOrder("laser", 100.0, 25.0, 10), frames=8)
    with pytest.raises(RunUsageError, match="50 frames/s, and the camera can take 30"):
        FlowStep(sides, SimpleNamespace(wanted=False), None, print, light).take(step, {})


def source_of(camera, arm, clock):
    made = PairSource(
        "behind", SimpleNamespace(camera=camera, raise_ambiguity=Source("behind", []).raise_ambiguity), SECTION
    )
    made._arm, made._clock = arm, clock
    return made


def test_without_a_clock_nothing_is_fired():
    with pytest.raises(RunUsageError, match="the clock of behind cannot be read"):
        source_of(SimpleNamespace(clock_ns=lambda: None), None, None).tell_clock()


@pytest.mark.parametrize("stamp_ns", [99, 10**9])
def test_stamps_of_another_clock_than_the_one_that_can_be_read_are_not_believed(stamp_ns):
    """They would lie before the arming, or behind the arrival of their frame."""
    arm = Shot(10**8, 5 * 10**8, 5 * 10**8 + 10**6)
    source = source_of(None, arm, (5 * 10**8, 10**8))
    late = replace(META, timestamp_ns=2 * 10**8, received_ns=6 * 10**8 + 10**6)
    assert source.host_ns((SimpleNamespace(meta=late), None)) == 6 * 10**8
    other = replace(late, timestamp_ns=stamp_ns)
    with pytest.raises(FrameDoubt, match="are not those of the clock"):
        source.host_ns((SimpleNamespace(meta=other), None))
