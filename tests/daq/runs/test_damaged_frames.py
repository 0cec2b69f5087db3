"""A frame that is not what was written is refused by name, wherever it is read."""

import re
import shutil
from itertools import pairwise

import numpy as np
import pytest
import tifffile

from daq.errors import RunDamaged
from daq.pipeline.corrections import correct_from_disk
from daq.runner.session import reopen
from daq.runs.acquired import read_acquired
from daq.runs.raw_frame import read_raw, write_raw
from piv.errors import FrameDamaged
from piv.files.frame_file import read_frame
from rtpiv.command_line.cli import DEVICE, DONE, USAGE, main
from tests.daq.small_bench import SCENE


def flip(path, at=-100, bit=0):
    """Change one bit of a file; far from its end it is one of the pixels."""
    data = bytearray(path.read_bytes())
    data[at] ^= 1 << bit
    path.write_bytes(data)


def pixels_end(path):
    """Index one past the pixels: they are written last but for what the TIFF puts behind them."""
    with tifffile.TiffFile(path) as file:
        page = file.pages[0]
        return page.dataoffsets[0] + page.databytecounts[0]


def break_description(path):
    """Damage the name of the checksum, so that the file no longer seems to carry one."""
    data = path.read_bytes()
    assert data.count(b'"crc32"') == 1
    path.write_bytes(data.replace(b'"crc32"', b'"crc3R"'))


def halve_rows(path):
    """The same bytes as a frame of half the width and twice the height: its checksum is right."""
    data = bytearray(path.read_bytes())
    with tifffile.TiffFile(path) as file:
        for name, factor in (("ImageWidth", 0.5), ("ImageLength", 2), ("RowsPerStrip", 2)):
            tag = file.pages[0].tags[name]
            value, length = int(tag.value * factor), {3: 2, 4: 4}[tag.dtype]
            data[tag.valueoffset : tag.valueoffset + length] = value.to_bytes(length, "little")
    path.write_bytes(data)
    assert tifffile.imread(path).shape == (192, 48)


DAMAGES = {
    "a flipped bit": lambda path: flip(path, pixels_end(path) - 1),
    "20 kB of noise": lambda path: path.write_bytes(
        path.read_bytes()[: pixels_end(path) - 18_000] + bytes(18_000) + path.read_bytes()[pixels_end(path) :]
    ),
    "half a file": lambda path: path.write_bytes(path.read_bytes()[:4000]),
    "no file": lambda path: path.unlink(),
    "an empty file": lambda path: path.write_bytes(b""),
    "a lost checksum": lambda path: (break_description(path), flip(path, pixels_end(path) - 1)),
    "rows of half the length": lambda path: halve_rows(path),
    "another frame": lambda path: shutil.copy(path.with_name("000004.tif"), path),
}


@pytest.fixture(params=DAMAGES)
def damage(request):
    return DAMAGES[request.param]


def test_every_frame_of_a_whole_run_is_read(done_run):
    for path in sorted((done_run.path / "frames").iterdir()):
        assert np.array_equal(read_acquired(path), read_raw(path)[0])


def test_resume_refuses_and_names_frame_and_cure(open_run, damage, capsys):
    damage(open_run.frame_path(3))
    assert main(["acquire", "--resume", str(open_run.path)]) == DEVICE
    said = capsys.readouterr().err
    assert "frames/000003.tif" in said
    assert f"rtpiv acquire --resume {open_run.path} --retake" in said
    assert "1 of 8 frames are not what was written" in said
    with pytest.raises(RunDamaged, match=r"000003\.tif"):
        reopen(open_run.path)


def test_report_refuses(done_run, damage, capsys):
    damage(done_run.frame_path(3))
    assert main(["report", str(done_run.path)]) == DEVICE
    assert re.search(r"rtpiv report: .*000003\.tif: .*(restore|take it again)", capsys.readouterr().err)


def test_evaluate_refuses(done_run, damage, tmp_path, capsys):
    damage(done_run.frame_path(3))
    assert main(["evaluate", str(done_run.path), "-o", str(tmp_path / "out")]) == DEVICE
    assert "000003.tif" in capsys.readouterr().err
    assert not list((tmp_path / "out").glob("*/vectors.nc"))  # nor any other pair: all frames are read first


def test_correct_refuses_a_frame_of_a_run(done_run, damage, tmp_path, capsys):
    damage(done_run.frame_path(3))
    (tmp_path / "scene.yaml").write_text(SCENE.format(side=96, pitch_um=231.0))
    frames = [str(done_run.frame_path(number)) for number in (2, 3)]
    assert (
        main(["correct", *frames, "--scene", str(tmp_path / "scene.yaml"), "-o", str(tmp_path / "out")]) == DEVICE
    )
    assert "000003.tif" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_correction_after_the_run_refuses(open_run, damage):
    damage(open_run.frame_path(3))
    corrections, step = type("Any", (), {"of": lambda self, step: np.asarray})(), object()
    with pytest.raises((RunDamaged, FrameDamaged), match=r"000003\.tif"):
        correct_from_disk(open_run, corrections, step, 3)


def test_frames_that_changed_places_are_both_refused(done_run):
    first, second = done_run.frame_path(2), done_run.frame_path(3)
    third = first.with_name("between.tif")
    for source, target in pairwise((third, first, second, third)):
        target.rename(source)
    for path in (first, second):
        with pytest.raises(FrameDamaged, match="does not agree with its checksum"):
            read_acquired(path)


def test_a_frame_without_a_line_is_refused(done_run):
    stranger = done_run.frame_path(77)
    shutil.copy(done_run.frame_path(3), stranger)
    with pytest.raises(RunDamaged, match="not in the journal"):
        read_acquired(stranger)


def test_a_copy_elsewhere_is_compared_with_what_it_carries_itself(done_run, tmp_path, capsys):
    good, bad = tmp_path / "good.tif", tmp_path / "bad.tif"
    for path in (good, bad):
        shutil.copy(done_run.frame_path(3), path)
    flip(bad, pixels_end(bad) - 1)
    (tmp_path / "scene.yaml").write_text(SCENE.format(side=96, pitch_um=231.0))
    options = ["--scene", str(tmp_path / "scene.yaml"), "-o", str(tmp_path / "out")]
    assert main(["correct", str(good), str(bad), *options]) == DEVICE
    assert "bad.tif: does not agree with its checksum" in capsys.readouterr().err
    assert main(["correct", str(good), *options]) == DONE
    data = good.read_bytes()
    good.write_bytes(data.replace(b'"crc32": "', b'"crc32": 5'))
    with pytest.raises(FrameDamaged, match="the checksum in its description is damaged"):
        read_frame(good)


def test_files_without_a_checksum_are_read_as_ever(tmp_path, capsys):
    path = tmp_path / "other.tif"
    tifffile.imwrite(path, np.arange(20, dtype=np.uint16).reshape(4, 5), description="from another program")
    assert read_frame(path).sum() == 190
    (tmp_path / "cut.tif").write_bytes(path.read_bytes()[:60])
    (tmp_path / "scene.yaml").write_text(SCENE.format(side=96, pitch_um=231.0))
    options = ["--scene", str(tmp_path / "scene.yaml"), "-o", str(tmp_path / "out")]
    assert main(["correct", str(tmp_path / "cut.tif"), *options]) == USAGE
    assert "cut.tif" in capsys.readouterr().err


def test_a_raw_frame_always_carries_its_checksum(tmp_path):
    path = tmp_path / "a.tif"
    write_raw(path, np.zeros((4, 4), np.uint16), {})
    break_description(path)
    with pytest.raises(RunDamaged, match="has lost its checksum"):
        read_raw(path)
