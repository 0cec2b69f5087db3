"""The command line from outside: quick help, one sentence for each mistake, nothing half-written."""

import os
import re
import subprocess
import sys
import warnings
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest
import tifffile

from daq import cameras
from ground.errors import RtpivWarning
from rtpiv.command_line import cli
from rtpiv.command_line.cli import DEVICE, USAGE, main
from rtpiv.options.command import commands, parser_of
from tests.loops import loop_over

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
SMALL = """
camera: {focal_px: 400.0, sensor_px: [96, 96], position_mm: [0.0, 0.0, 500.0]}
bodies: [{name: ball, kind: sphere, centre_mm: [0.0, 0.0, 25.0], radius_mm: 25.0, material: N-BK7}]
"""


@pytest.fixture
def bench(tmp_path):
    """A folder with a small scene and a good frame."""
    (tmp_path / "scene.yaml").write_text(SMALL)
    frame = np.random.default_rng(0).integers(100, 200, (96, 96)).astype(np.uint16)
    tifffile.imwrite(tmp_path / "good.tif", frame)
    return tmp_path


def run(bench, *frames, scene="scene.yaml", options=()):
    out = bench / "out"
    names = [str(bench / name) for name in frames]
    return main(["correct", *names, "--scene", str(bench / scene), "-o", str(out), *options]), out


def test_help_is_quick_and_imports_nothing_heavy():
    """Of the command itself and of the verb that takes most."""
    show = "import sys; import rtpiv.command_line.cli as c; c.parser"
    heavy = "print(*({'numba', 'numpy', 'cv2'} & sys.modules.keys()))"
    assert _run(f"{show}(); {heavy}")[0] == ""  # the options of all verbs
    nothing_s = min(_run("pass")[1] for _ in range(2))
    for words in (["--help"], ["evaluate", "--help"]):
        assert min(_run(f"{show}({words}).format_help()")[1] for _ in range(2)) < nothing_s + 0.3


def test_help_sends_nobody_into_the_code():
    """Who installs a wheel has no modules to read: no dotted name of ours stands in any help."""
    ours = "rtpiv|ground|piv|tracer|correction|stages|daq|sim"
    dotted = re.compile(rf"\b(?:{ours})\.(?!json|yaml|html)[a-z_]{{3,}}\b")
    for verb in commands():
        said = dotted.findall(" ".join(parser_of(verb).format_help().split()))
        assert not said, (verb, said)


def _run(code):
    """What a program says, and its seconds of processor time: on a clock the machine's load would be judged."""
    before = os.times()
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    after = os.times()
    return said.strip(), sum(after[2:4]) - sum(before[2:4])


def test_version(capsys):
    with pytest.raises(SystemExit) as caught:
        main(["--version"])
    assert caught.value.code == 0
    assert capsys.readouterr().out == f"rtpiv {version('rtpiv')}\n"


@pytest.mark.posix("a simulated camera that needs an extra")
@pytest.mark.parametrize("verb", ["demo", "acquire"])
def test_a_missing_extra_is_named_before_anything_is_done(verb, monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(cameras, "find_spec", lambda name: None)
    options = [str(EXAMPLES / "plan-target.yaml"), "--bench", str(EXAMPLES / "bench-sim.yaml"), "--simulate"]
    assert main([verb, *(options if verb == "acquire" else []), "-o", str(tmp_path / "out")]) == DEVICE
    said = capsys.readouterr().err
    assert "harvesters and genicam" in said
    assert "rtpiv[camera]" in said
    assert len(said.splitlines()) == 1
    assert not (tmp_path / "out").exists()


@loop_over("arguments", [["nonsense"], ["correct"], ["trace"], ["correct", "a.tif"]])
def test_usage_errors_exit_with_2(arguments, capsys):
    with pytest.raises(SystemExit) as caught:
        main(arguments)
    assert caught.value.code == USAGE
    assert "usage" in capsys.readouterr().err


@pytest.mark.draws
def test_a_good_frame_is_corrected(bench):
    code, out = run(bench, "good.tif")
    assert code == 0
    assert {path.name for path in out.glob("[!.]*")} == {"good.tif", "mask.tif", "overview.png", "correction.json"}


def broken(bench):
    content = (bench / "good.tif").read_bytes()
    (bench / "truncated.tif").write_bytes(content[: len(content) // 2])
    tifffile.imwrite(bench / "inks.tif", np.zeros((96, 96, 4), np.uint8), photometric="separated")
    tifffile.imwrite(bench / "small.tif", np.zeros((90, 96), np.uint16))
    tifffile.imwrite(bench / "mask.tif", np.zeros((96, 96), np.uint16))
    (bench / "unknown_key.yaml").write_text(SMALL.replace("radius_mm", "radius_cm"))
    (bench / "inside.yaml").write_text(SMALL.replace("0.0, 25.0]", "0.0, 500.0]"))
    (bench / "number.yaml").write_text(SMALL.replace("500.0", "5e2"))
    (bench / "nan.yaml").write_text(SMALL.replace("500.0", ".nan"))


@loop_over(
    "frame, scene, options, words",
    [
        ("truncated.tif", "scene.yaml", (), ["truncated.tif", "damaged"]),
        ("inks.tif", "scene.yaml", (), ["inks.tif", "grey"]),
        ("small.tif", "scene.yaml", (), ["small.tif", "96 x 90 px"]),
        ("missing.tif", "scene.yaml", (), ["missing.tif", "cannot be read"]),
        ("mask.tif", "scene.yaml", (), ["mask", "name"]),
        ("good.tif", "missing.yaml", (), ["missing.yaml", "cannot be read"]),
        ("good.tif", "unknown_key.yaml", (), ["unknown_key.yaml:3", "radius_mm"]),
        ("good.tif", "inside.yaml", (), ["inside.yaml", "ball"]),
        ("good.tif", "number.yaml", (), ["number.yaml:2", "decimal point"]),
        ("good.tif", "nan.yaml", (), ["nan.yaml:2", "finite"]),
        ("good.tif", "scene.yaml", ("--target-clear", "good.tif"), ["good.tif", "no chessboard"]),
        ("good.tif", "scene.yaml", ("--target-clear", "truncated.tif"), ["truncated.tif", "damaged"]),
    ],
)
def test_bad_input_is_one_sentence_with_exit_2_and_nothing_written(bench, capsys, frame, scene, options, words):
    broken(bench)
    options = [str(bench / option) if option.endswith(".tif") else option for option in options]
    code, out = run(
        bench,
        "good.tif" if frame != "good.tif" else frame,
        *[frame] * (frame != "good.tif"),
        scene=scene,
        options=options,
    )
    said = capsys.readouterr().err
    assert code == USAGE
    assert all(word in said for word in words), said
    assert "Traceback" not in said
    assert not out.exists()


@loop_over("option", ["--blend=0", "--blend=-1", "--blend=x", "--square-mm=0", "--square-mm=nan", "--square-mm=x"])
def test_numbers_that_make_no_sense_are_refused(option, capsys):
    with pytest.raises(SystemExit) as caught:
        main(["correct", "a.tif", "--scene", "b.yaml", "-o", "c", option])
    assert caught.value.code == USAGE
    assert f"argument {option.partition('=')[0]}: should be " in capsys.readouterr().err


def test_more_views_than_can_be_joined_are_refused(bench, capsys):
    code, out = run(bench, "good.tif", options=("--blend", "17"))
    assert code == USAGE
    assert "1 to 16 views" in capsys.readouterr().err
    assert not out.exists()


def test_an_output_folder_that_is_a_file_is_one_sentence(bench, capsys):
    (bench / "out").write_text("mine")
    code, out = run(bench, "good.tif")
    assert code == USAGE
    assert str(out) in capsys.readouterr().err
    assert out.read_text() == "mine"


def test_several_problems_are_reported_at_once(bench, capsys):
    (bench / "bad.yaml").write_text(SMALL.replace("radius_mm", "radius_cm").replace("focal_px", "focal"))
    code, _ = run(bench, "good.tif", scene="bad.yaml")
    said = capsys.readouterr().err
    assert code == USAGE
    assert "bad.yaml:2" in said
    assert "bad.yaml:3" in said


@pytest.mark.slow
@pytest.mark.draws
def test_trace_leaves_pictures(bench):
    assert main(["trace", str(bench / "scene.yaml"), "-o", str(bench / "trace")]) == 0
    names = {path.name for path in (bench / "trace").glob("[!.]*")}
    assert names == {"plane.png", "camera_view.png", "slant.png", "scene.png", "radial_curve.png"}
    for path in (bench / "trace").glob("[!.]*"):
        assert path.stat().st_size > 1000


def test_warnings_of_libraries_do_not_reach_the_user(capsys):
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        warnings.showwarning = cli.print_warning  # as `main` does
        assert np.isnan(np.nanmedian([np.nan]))  # All-NaN slice encountered
        assert capsys.readouterr().err == ""
        warnings.warn("the bench has no watchdog", RtpivWarning, stacklevel=1)
    assert "the bench has no watchdog" in capsys.readouterr().err


def test_neither_pictures_nor_frames_of_something_else_are_overwritten(bench, tmp_path, capsys):
    out, refused = tmp_path / "out", "made from something else; give another folder with -o, or --overwrite"
    other = tmp_path / "other.yaml"
    other.write_bytes((bench / "scene.yaml").read_bytes())
    trace = ["trace", str(bench / "scene.yaml"), "-o", str(out)]
    assert main(trace) == main(trace) == 0  # the same once more
    before = {file.name: file.read_bytes() for file in out.iterdir()}
    assert main(["trace", str(other), "-o", str(out)]) == 2
    assert refused in capsys.readouterr().err
    assert {file.name: file.read_bytes() for file in out.iterdir()} == before
    # Corrected frames have the names of acquired ones, so a folder with those loses none.
    (tmp_path / "day").mkdir()
    frame, words = tmp_path / "day" / "good.tif", ["--scene", str(bench / "scene.yaml"), "--no-pictures"]
    frame.write_bytes((bench / "good.tif").read_bytes())
    assert main(["correct", str(frame), *words, "-o", str(frame.parent)]) == 2
    assert refused in capsys.readouterr().err
    assert frame.read_bytes() == (bench / "good.tif").read_bytes()
