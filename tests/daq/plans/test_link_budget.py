"""What does not fit through the camera's link is said before anything moves, with a cure that does cure."""

import re

import pytest

from daq.bench.bench_file import load_bench
from daq.bench.guards import idle_stage
from daq.cameras.files import FilesCamera
from daq.errors import RunUsageError
from daq.plans.forecast import forecast
from daq.plans.link_budget import require_link
from daq.plans.plan import load_plan
from daq.runner.run_camera import RunCamera
from daq.runner.runner import Runner
from daq.runner.session import Request, begin
from rtpiv.verbs.check import check_files
from tests.daq.plans.test_flow_plan import PAIRS, PLAN, SETTINGS, flow
from tests.daq.runner.test_two_cameras import write_two
from tests.daq.small_bench import FILES_CAMERA, files_bench, load, write_frames

BIG = SETTINGS.replace("{Exp", "{PixelFormat: Mono16, Width: 2016, Height: 2016, Exp")
GIGE = ", link: 1GigE"


def said(folder, settings=BIG + GIGE, plan=PLAN, pairs=PAIRS):
    bench, made = flow(folder, plan=plan, settings=settings, pairs=pairs)
    found = forecast(bench, idle_stage(bench), made.steps)
    return found.link, " ".join(violation.text for violation in found.violations if "MB" in violation.text)


def test_pairs_of_a_reference_camera_exceed_a_gigabit(tmp_path):
    need, refused = said(tmp_path)
    assert "2016 x 2016 px in Mono16 are 8.13 MB a frame, 10 x 2 frames/s need 162.6 MB/s" in refused
    assert "1GigE carries 113.0 MB/s" in refused
    assert "set PixelFormat to Mono12p (121.9 MB/s)" in refused
    assert "162.6 MB/s" in need


def test_the_cure_cures(tmp_path):
    _, refused = said(tmp_path / "a")
    rows, rate_hz = re.search(r"Height of (\d+) at most, or ([\d.]+) Hz", refused).groups()
    packed = BIG.replace("Mono16", "Mono12p") + GIGE
    assert not said(tmp_path / "b", packed.replace("Height: 2016", f"Height: {rows}"))[1]
    assert said(tmp_path / "c", packed.replace("Height: 2016", f"Height: {int(rows) + 4}"))[1]
    slower = PLAN.replace("rate_hz: 10.0", f"rate_hz: {rate_hz}")
    assert not said(tmp_path / "d", packed, slower)[1]
    assert said(tmp_path / "e", packed, PLAN.replace("rate_hz: 10.0", f"rate_hz: {float(rate_hz) + 0.2}"))[1]


def test_a_packed_format_alone_may_do(tmp_path):
    _, refused = said(tmp_path, BIG.replace("Height: 2016", "Height: 1600") + GIGE)
    assert refused.endswith("set PixelFormat to Mono12p (96.8 MB/s), or use a faster link")


def test_halves_of_one_buffer_are_sent_once(tmp_path):
    halves = "{shape: double_height, dead_us: 2.0, second_exposure_us: 20000.0, most_hz: 12.0}"
    settings = SETTINGS.replace("{Exp", "{PixelFormat: Mono16, Width: 2016, Height: 4032, Exp")
    assert "10 frames/s need 162.6 MB/s" in said(tmp_path / "a", settings + GIGE, pairs=halves)[1]
    unsaid = SETTINGS.replace("{Exp", "{PixelFormat: Mono16, Exp")
    assert "96 x 192 px" in said(tmp_path / "b", unsaid, pairs=halves)[0]


@pytest.mark.parametrize("link", ["2.5GigE", "5GigE", "USB3"])
def test_what_fits_is_allowed(tmp_path, link):
    assert not said(tmp_path, BIG + f", link: {link}")[1]


def test_an_unknown_link_is_believed_and_its_need_said(tmp_path):
    need, refused = said(tmp_path, BIG)
    assert not refused
    assert "Ethernet that carries it: 2.5GigE (set camera.link)" in need


def test_check_says_it_with_the_file(tmp_path):
    bench, plan = flow(tmp_path, settings=BIG + GIGE)
    with pytest.raises(RunUsageError, match=r"plan-flow.yaml: step 1 \(flow_glass\).*162.6 MB/s.*Mono12p"):
        check_files([bench.path, plan.path])


def test_the_camera_s_own_word_counts_before_anything_moves(tmp_path):
    bench, plan = flow(tmp_path, settings=BIG)
    told = {"PixelFormat": "Mono16", "PayloadSize": 8_128_512, "GevLinkSpeed": 1000, "GevSCPSPacketSize": 9000}
    with pytest.raises(RunUsageError, match=r"step 1 .*162.6 MB/s, and the camera's link carries 117.8"):
        require_link(bench, plan.steps, told)
    require_link(bench, plan.steps, told | {"GevLinkSpeed": 10_000})
    require_link(bench, plan.steps, {"PixelFormat": "Mono16"})


class SlowLink(FilesCamera):
    """A camera behind a cable of 10 Mbit/s, as it says itself."""

    def settings(self):
        return super().settings() | {"GevLinkSpeed": 10}


def test_a_run_is_refused_before_anything_moves(tmp_path):
    free = FILES_CAMERA.replace('"On", TriggerSource: Software', '"Off", AcquisitionFrameRate: 100.0')
    bench, plan = load(tmp_path, "experiment: stream\nview: clear\nframes: 4\n", camera=free)
    folder = begin(Request(bench.path, plan.path, correct=False), bench, plan, tmp_path / "runs")
    with files_bench(bench, write_frames(tmp_path / "frames_in", 4), SlowLink) as hardware:
        here_mm = hardware.simulation.true_mm()
        with pytest.raises(RunUsageError, match=r"100 frames/s need 1.8 MB/s, and the camera's link carries 1.1"):
            Runner(hardware, [RunCamera(hardware, folder)], plan.steps).run()
        assert hardware.simulation.true_mm() == here_mm
    assert not list((folder.path / "frames").iterdir())


def test_every_camera_needs_disk_and_link(tmp_path):
    path, plan = write_two(tmp_path, changes=("  timeout_s", "  link: 1GigE\n    timeout_s"))
    bench = load_bench(path)
    made, stage = load_plan(plan, bench), idle_stage(bench)
    alone = forecast(bench, stage, made.steps)
    both = forecast(bench, stage, made.steps, cameras=made.table.further_cameras)
    side = bench.scene.camera.sensor_px[0]
    assert both.frames == alone.frames
    assert both.raw_bytes == 2 * alone.raw_bytes - alone.frames * 2 * 16 * side  # 16 columns fewer
    first, behind = both.link.splitlines()
    assert first.startswith("camera: link: ")
    assert behind.startswith("behind: link: ")
    assert "of 113.0" in behind  # the first one names no link
    assert len(both.violations) == len(alone.violations)
