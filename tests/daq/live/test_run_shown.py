"""A run that is looked at: the page shows what its threads did, and the run is the one that nobody looks at."""

import json
import threading

import pytest

pytest.importorskip("websockets")
from websockets.sync.client import connect

from daq.live.live_page import LivePage
from daq.live.run_shown import RunShown
from daq.pipeline.corrections import Corrections
from daq.runner.run_camera import RunCamera
from daq.runner.runner import Runner
from daq.runner.session import Request, begin
from tests.daq.small_bench import FILES_CAMERA, SHIFT, SIDE_PX, files_bench, load, write_frames
from tests.slow_cases import slow

PLAN = SHIFT + "frames: 3\n"


def pixels_of(folder):
    return [path.read_bytes()[-2 * SIDE_PX**2 :] for path in sorted((folder.path / "frames").glob("*.tif"))]


@pytest.mark.slow
@pytest.mark.parametrize("is_corrected", [True, slow(False)])
def test_a_run_is_the_same_with_a_page(tmp_path, is_corrected):
    bench, plan = load(tmp_path, PLAN, camera=FILES_CAMERA)
    files, folders, seen = write_frames(tmp_path / "frames_in", 40), [], []
    looks = threading.Event()
    corrections = Corrections(bench.scene) if is_corrected else None
    for is_shown in (False, True):
        folder = begin(Request(bench.path, plan.path), bench, plan, tmp_path / f"runs{is_shown}")
        folders.append(folder)
        if not is_shown:
            with files_bench(bench, files) as hardware:
                Runner(hardware, [RunCamera(hardware, folder, corrections)], plan.steps).run()
            continue
        with LivePage(12 * SIDE_PX**2, scene=bench.scene, board=bench.board) as page:
            shown = RunShown(page, folder, "97 % is seen through glass")

            def look():
                origin, token = page.url.rstrip("/").split("/#")
                with connect(f"ws{origin[4:]}/frames", origin=origin, compression=None, max_size=None) as found:
                    found.send(json.dumps({"token": token}))
                    while not seen or not seen[-1].get("over"):
                        words = json.loads(found.recv(timeout=30.0))
                        looks.set()
                        if not words.keys() & {"number", "over"}:
                            continue  # a sign of life
                        pictures = [found.recv(timeout=30.0) for _ in words.get("shown", ())]
                        seen.append(words | {"pictures": len(pictures)})
                        if not words.get("over"):
                            found.send(json.dumps({"drawn": words["number"]}))

            viewer = threading.Thread(target=look)
            viewer.start()
            assert looks.wait(30.0)
            with files_bench(bench, files) as hardware:
                watching = shown.watching(lambda progress: None)
                done = Runner(
                    hardware, [RunCamera(hardware, folder, corrections, show=shown.show)], plan.steps, watching
                ).run()
        viewer.join(30.0)
    assert pixels_of(folders[0]) == pixels_of(folders[1])
    assert done["frames"] == len(pixels_of(folders[0])) == 24
    frames, over = seen[:-1], seen[-1]
    assert over["over"] == "ended"
    behind = {words["run"]: "_glass_" in words["run"] for words in frames}
    assert any(behind.values())
    assert all(run.endswith("; 97 % is seen through glass") == is_behind for run, is_behind in behind.items())
    doings = {words["doing"].partition(", ")[0] for words in frames}
    doings -= {"correcting what was skipped"}  # on a busy computer
    # Words come another way than frames: "starting" may come after the first.
    assert doings <= {"starting", "waiting for the camera's first frame", "exposing", "moving", "closing"}
    assert frames[0]["run"].startswith(folders[1].path.name)
    assert all(words["has"] == ["raw", "corrected"][: words["pictures"]] for words in frames)
    assert any(words["pictures"] == 2 for words in frames) == is_corrected
    assert all(words["bits"] == 16 for words in frames)
    assert all(words["view"] == ("glass" if "glass" in words["run"] else "clear") for words in frames)
    assert frames[-1]["counters"]["room on the disk"][0].endswith(("min", "h"))
    last = frames[-1]
    assert last["missed"] + len(frames) == last["number"] - frames[0]["number"] + 1
    assert last["number"] <= done["frames"]
    assert last["counters"]["frames"][0].endswith("of 24")
    assert last["counters"]["lost or incomplete"] == ["0", False]
