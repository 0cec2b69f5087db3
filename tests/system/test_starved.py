"""A stream that computer or disk cannot follow: it ends with the reason, and every frame is in the books.

More gaps at one go than the plan allows end it at once, so there are as many underruns as that takes and no more;
what it has stays, and resuming on a disk that has been mended takes the rest.
"""

import time

import numpy as np
import pytest

from daq.pipeline import pipeline as pipeline_module
from daq.runs.raw_frame import checksum, read_raw, write_raw
from daq.runs.run_folder import RunFolder, frame_entries
from rtpiv.command_line.cli import DEVICE, main
from tests.daq.small_bench import write_bench

pytest.importorskip("harvesters", reason="the camera needs harvesters (extra rtpiv[camera])")

FRAMES, SIDE_PX = 100, 64
CAMERA = """camera:
  backend: harvesters
  settings: {PixelFormat: Mono12p, ExposureTime: 100.0, TriggerMode: "Off", AcquisitionFrameRate: 100.0}
  buffers: 4
  timeout_s: 5.0
"""


@pytest.mark.slow
def test_a_disk_that_cannot_follow_a_stream_ends_it_with_that_reason(tmp_path, monkeypatch, capsys):
    write_bench(tmp_path, SIDE_PX, "ring: ring\nrow_time_us: 1.0", CAMERA)
    (tmp_path / "ring").mkdir()
    np.save(tmp_path / "ring" / "0.npy", np.full((SIDE_PX, SIDE_PX), 100, np.uint16))
    (tmp_path / "plan.yaml").write_text(f"experiment: stream\nview: clear\nframes: {FRAMES}\n")

    def slow(path, pixels, about):
        time.sleep(0.2)  # two writers: 10 frames/s
        write_raw(path, pixels, about)

    monkeypatch.setattr(pipeline_module, "write_raw", slow)
    options = ["--bench", str(tmp_path / "bench.yaml"), "-o", str(tmp_path / "runs"), "--simulate", "--home"]
    assert main(["acquire", str(tmp_path / "plan.yaml"), *options, "--no-correct"]) == DEVICE
    said = capsys.readouterr().err
    assert "no buffer was free (disk or computer too slow)" in said
    assert "rtpiv acquire --resume" in said

    run = RunFolder(next((tmp_path / "runs").glob("*_plan")))
    assert not run.is_done
    books = next(entry for entry in run.entries() if entry["kind"] == "counts")["books"]
    assert books["imbalance"] == 0
    assert books["underrun"] > FRAMES // 10
    assert books["missing"] == books["unwritten"] == 0
    frames = frame_entries(run.entries())
    assert len(frames) == books["written"] > 4
    for number, entry in frames.items():
        assert checksum(read_raw(run.frame_path(number))[0]) == entry["crc32"]
