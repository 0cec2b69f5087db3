"""The same step list on a Bluesky RunEngine and on our runner: the same frames at the same places."""

import pytest

from daq.plans.steps import route
from daq.runner.camera_session import CameraSession
from daq.runner.devices import AxisDevice, CameraDevice
from daq.runner.run_camera import RunCamera
from daq.runner.runner import Runner
from daq.runner.session import Request, begin
from daq.runs.run_folder import frame_entries
from stages.errors import OutOfRange
from tests.daq.small_bench import FILES_CAMERA, SHIFT, files_bench, load, write_frames

protocols = pytest.importorskip("bluesky.protocols")
PLAN = SHIFT + "frames: 2\n"


@pytest.fixture
def bench_and_plan(tmp_path):
    write_frames(tmp_path / "frames_in", 20)
    return load(tmp_path, PLAN, camera=FILES_CAMERA)


def ours(tmp_path, bench, plan):
    folder = begin(Request(bench.path, plan.path, correct=False), bench, plan, tmp_path / "runs")
    with files_bench(bench, tmp_path / "frames_in") as hardware:
        Runner(hardware, [RunCamera(hardware, folder)], plan.steps).run()
    entries = frame_entries(folder.entries())
    return [
        (entry["tag"], entry["crc32"], entry["measured_mm"], entry["true_mm"])
        for _, entry in sorted(entries.items())
    ]


def theirs(tmp_path, bench, plan):
    """Steps as messages: the engine moves, triggers and collects; it knows nothing of our runner."""
    from bluesky import RunEngine
    from bluesky import plan_stubs as bps
    from bluesky import preprocessors as bpp

    with files_bench(bench, tmp_path / "frames_in") as hardware:
        axes = {name: AxisDevice(hardware.stage, name) for name in hardware.stage.axes}
        camera = CameraDevice(CameraSession(hardware.camera, hardware.camera_section))
        order = list(hardware.stage.axes)
        truths, tags, documents = [], [], []

        @bpp.stage_decorator([camera])
        @bpp.run_decorator(md={"plan": plan.name})
        def messages():
            here = hardware.stage.where_mm()
            for step in plan.steps:
                for move in route(bench, here, step.targets_mm):
                    for name in sorted(move, key=order.index):
                        yield from bps.mv(axes[name], move[name])
                here = step.targets_mm
                for _ in step.numbers:
                    yield from bps.checkpoint()
                    yield from bps.trigger_and_read([camera, *axes.values()])
                    truths.append(hardware.simulation.true_mm())
                    tags.append(step.tag)

        engine = RunEngine({}, context_managers=[])
        engine(messages(), lambda name, document: documents.append((name, document)))
    stop = documents[-1][1]
    assert stop["exit_status"] == "success"
    events = [document["data"] for name, document in documents if name == "event"]
    return [
        (tag, event["camera_crc32"], {name: event[name] for name in order}, true)
        for tag, event, true in zip(tags, events, truths, strict=True)
    ]


def test_runner_and_run_engine_record_the_same(tmp_path, bench_and_plan):
    bench, plan = bench_and_plan
    one, other = ours(tmp_path, bench, plan), theirs(tmp_path, bench, plan)
    assert len(one) == len(other) == 16
    for mine, engines in zip(one, other, strict=True):
        assert mine[0] == engines[0]
        assert mine[1] == engines[1]
        for name, mm in mine[2].items():
            assert engines[2][name] == pytest.approx(mm, abs=1e-9)
            assert engines[3][name] == pytest.approx(mine[3][name], abs=10e-3)


def test_devices_satisfy_the_protocols(tmp_path, bench_and_plan):
    bench, _ = bench_and_plan
    with files_bench(bench, tmp_path / "frames_in") as hardware:
        axis = AxisDevice(hardware.stage, "target_x")
        camera = CameraDevice(CameraSession(hardware.camera, hardware.camera_section))
        for name in ("Movable", "Readable", "Locatable", "Stoppable", "Checkable"):
            assert isinstance(axis, getattr(protocols, name)), name
        for name in ("Triggerable", "Readable", "Stageable"):
            assert isinstance(camera, getattr(protocols, name)), name
        status = axis.set(1.0)
        assert isinstance(status, protocols.Status)
        assert status.exception(10.0) is None
        assert status.success
        assert axis.locate()["readback"] == pytest.approx(1.0, abs=5e-3)
        axis.stop()  # idle: must change nothing
        assert axis.set(0.5).exception(10.0) is None
        with pytest.raises(OutOfRange):
            axis.check_value(1e9)
        assert isinstance(axis.set(float("nan")).exception(10.0), OutOfRange)
