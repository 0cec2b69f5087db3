"""A finished shift run that tests copy and damage."""

from daq.runner.run_camera import RunCamera
from daq.runner.runner import Runner
from daq.runner.session import Request, begin
from tests.daq.small_bench import FILES_CAMERA, SHIFT, files_bench, load, write_frames


def make_whole_run(place):
    """Eight frames of two times two displacements over byte protocols, 96 px a side."""
    files = write_frames(place / "frames_in", 40)
    bench, plan = load(place, SHIFT, camera=FILES_CAMERA)
    folder = begin(Request(bench.path, plan.path, correct=False), bench, plan, place / "runs")
    with files_bench(bench, files) as hardware:
        Runner(hardware, [RunCamera(hardware, folder)], plan.steps).run()
    return folder
