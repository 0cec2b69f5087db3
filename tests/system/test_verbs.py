"""The verbs from outside: words, exit codes, Ctrl-C on (pseudo-)terminals, other programs on our bench."""

import re

import pytest

from rtpiv.command_line.cli import DEVICE, DONE, USAGE, main
from tests.daq.small_bench import FILES_CAMERA, write_bench, write_frames

PLAN = "experiment: shift\nviews: [glass]\ndisplacements: [{along: [1.0, 0.0, 0.0], mm: 20.0}]\nrepeats: 3\n"


def bench_options(folder):
    return ["--bench", str(folder / "bench.yaml"), "--simulate"]


def test_stage_verbs_move_and_refuse(tmp_path, capsys):
    """Each call is a new simulated world, so it wakes up without a reference, as a bench after power-up."""
    write_bench(tmp_path, camera=FILES_CAMERA)
    options = bench_options(tmp_path)
    assert main(["bench", "stage", "where", *options]) == DONE
    assert "unreferenced" in capsys.readouterr().out
    assert main(["bench", "stage", "move", "target_x=1.0", *options]) == USAGE
    assert "home it first" in capsys.readouterr().err
    assert main(["bench", "stage", "home", "target_x", *options]) == DONE
    assert re.search(r"target_x\D+target\s+\S\s+x\s+\S\s+-?\d+\.\d{4}\s+\S\s+ready", capsys.readouterr().out)
    assert main(["bench", "stage", "move", "target_x=wide", *options]) == USAGE
    assert "give axis=mm" in capsys.readouterr().err
    assert main(["bench", "stage", "jog", "nonsense=1.0", *options]) == USAGE
    assert "there is no axis 'nonsense'" in capsys.readouterr().err


def test_dry_run_opens_nothing_and_shows_violations(tmp_path, capsys):
    write_bench(tmp_path, camera=FILES_CAMERA)
    (tmp_path / "plan.yaml").write_text(PLAN)
    arguments = [
        "acquire",
        str(tmp_path / "plan.yaml"),
        *bench_options(tmp_path)[:2],
        "-o",
        str(tmp_path / "runs"),
    ]
    assert main([*arguments, "--dry-run"]) == DONE
    said = capsys.readouterr().out
    assert "6 steps, 6 frames" in said
    assert "particles_glass_d0_r2_b" in said
    assert not (tmp_path / "runs").exists()
    (tmp_path / "plan.yaml").write_text(PLAN.replace("20.0", "46.0"))
    assert main(arguments) == USAGE
    assert "3 of its moves or rates are not allowed; step 2 (particles_glass_d0_r0_b)" in capsys.readouterr().err


def test_what_is_not_there_is_a_device_error(tmp_path, capsys):
    write_bench(tmp_path)
    (tmp_path / "plan.yaml").write_text(PLAN)
    arguments = ["acquire", str(tmp_path / "plan.yaml"), "--bench", str(tmp_path / "bench.yaml")]
    assert main([*arguments, "-o", str(tmp_path / "runs"), "--no-correct"]) == DEVICE
    said = capsys.readouterr().err
    assert "/dev/ttyUSB0" in said
    assert "rtpiv acquire --resume" not in said  # there is nothing to go on with
    assert "nothing was taken, so this run is not kept; without hardware: --simulate" in said
    assert not list((tmp_path / "runs").iterdir())
    assert main(["acquire", "--resume", str(tmp_path / "nowhere")]) == USAGE
    assert "is not a run folder" in capsys.readouterr().err


def test_a_run_whose_axes_are_not_homed_leaves_no_folder(tmp_path, capsys):
    """Nor a hint to resume it: nothing was taken."""
    write_frames(tmp_path / "frames_in", 2)
    camera = FILES_CAMERA.replace("frames_in", str(tmp_path / "frames_in"))
    write_bench(tmp_path, camera=camera)
    (tmp_path / "plan.yaml").write_text(PLAN.replace("20.0", "1.0"))
    arguments = ["acquire", str(tmp_path / "plan.yaml"), *bench_options(tmp_path), "-o", str(tmp_path / "runs")]
    assert main([*arguments, "--no-correct"]) == USAGE
    said = capsys.readouterr().err
    assert "home them (--home" in said
    assert "nothing was taken, so this run is not kept" in said
    assert "resume" not in said
    assert not list((tmp_path / "runs").iterdir())


@pytest.mark.posix("ports that are files")
def test_doctor_looks_and_opens_nothing(tmp_path, capsys):
    write_bench(tmp_path)
    assert main(["doctor", "--bench", str(tmp_path / "bench.yaml")]) == DEVICE
    said, error = capsys.readouterr()
    assert "bench.yaml needs what is missing here: controller rail" in error
    assert main(["doctor"]) == DONE  # of what no bench needs nothing is missing
    for words in (
        "numpy",
        "package tracer",
        "camera backend aravis",
        "GenTL producers",
        "controller rail",
        "camera's producer",
    ):
        assert words in said


def test_camera_snap(tmp_path, capsys):
    write_frames(tmp_path / "frames_in", 2)
    folder = tmp_path / "frames_in"
    path = write_bench(tmp_path, camera=FILES_CAMERA.replace("frames_in", str(folder)))
    out = tmp_path / "snap.tif"
    assert main(["bench", "camera", "snap", "--bench", str(path), "-o", str(out)]) == DONE
    assert "saturated" in capsys.readouterr().out
    assert out.exists()
    assert main(["bench", "camera", "snap", "--bench", str(path), "-o", str(out)]) == DEVICE
    assert "never overwritten" in capsys.readouterr().err
