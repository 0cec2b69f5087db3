"""A series whose vectors contradict its order or its scale is not announced as a success."""

import numpy as np
import pytest
import tifffile

from piv.errors import PairError
from piv.files.vector_file import read_vectors
from rtpiv.analysis.pairs.plausible import scale_warnings
from rtpiv.analysis.series.run_series import run_series
from rtpiv.command_line.cli import DONE, USAGE, main
from tests.piv.conftest import make_pair
from tests.rtpiv.analysis.series.small_series import flow_run, frames_of, given_of, method_of, series_of
from tests.slow_cases import slow

OPTIONS = ["--final-window", "32", "--no-pictures", "--workers", "1"]
SCALE = ["--mm-per-px", "0.1", "--dt-us", "1000"]


def time_resolved(folder, count, shift=(2.0, 1.0), lost=(), renumbered=True, name="f{}.tif"):
    """Frames of one moving pattern: rolled by whole pixels, so that all frames show the same particles."""
    folder.mkdir()
    (first, _) = make_pair(lambda u, v: (0.0, 0.0), (96, 112), seed=1)
    kept = [k for k in range(count) if k not in lost]
    for number, k in enumerate(kept):
        frame = np.roll(first, (round(shift[1] * k), round(shift[0] * k)), (0, 1))
        tifffile.imwrite(folder / name.format(number if renumbered else k), frame)
    return folder


def evaluated(capsys, path, out, *more):
    assert main(["evaluate", str(path), *OPTIONS, *more, "-o", str(out)]) == DONE, capsys.readouterr().err
    return " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize(
    ("shift", "lost", "pair"),
    [
        ((2.0, 1.0), (3,), "f2.tif + f3.tif"),
        ((-3.0, 0.0), (5,), "f4.tif + f5.tif"),
        slow((0.0, 4.0), (5,), "f4.tif + f5.tif"),
    ],
)
def test_a_frame_lost_before_the_files_were_numbered(tmp_path, capsys, lost, pair, shift):
    folder = time_resolved(tmp_path / "day", 8, shift, lost)
    said = evaluated(capsys, f"{folder}@1-2,2-3", tmp_path / "out", *SCALE)
    assert f"1 pair moved twice as far as those before and after ({pair})" in said


def test_a_sound_series_and_one_that_speeds_up_are_not_doubted(tmp_path, capsys):
    folder = time_resolved(tmp_path / "day", 7)
    assert "twice as far" not in evaluated(capsys, f"{folder}@1-2,2-3", tmp_path / "out", *SCALE)
    faster = tmp_path / "faster"
    faster.mkdir()
    (first, _) = make_pair(lambda u, v: (0.0, 0.0), (96, 112), seed=1)
    for k in range(7):
        tifffile.imwrite(faster / f"f{k}.tif", np.roll(first, k * (k + 1) // 2, 1))
    assert "twice as far" not in evaluated(capsys, f"{faster}@1-2,2-3", tmp_path / "out2", *SCALE)


def test_frames_that_are_missing_by_their_numbers_are_told(tmp_path, capsys):
    folder = time_resolved(tmp_path / "day", 8, lost=(3, 4), renumbered=False)
    said = evaluated(capsys, f"{folder}@1-2,2-3", tmp_path / "out", *SCALE)
    assert "2 frames missing by number, between f2.tif and f5.tif; in no pair" in said
    assert "pairs: f0.tif + f1.tif, f1.tif + f2.tif, f5.tif + f6.tif" in said
    (folder / "f7.tif").unlink()
    said = evaluated(capsys, folder, tmp_path / "pairs", *SCALE)
    assert "3 frames without a partner" in said


def test_a_frame_lost_in_the_middle_of_single_pairs(tmp_path, capsys):
    folder = tmp_path / "day"
    folder.mkdir()
    frames = [frame for k in range(8) for frame in make_pair(lambda u, v: (3.0, 1.0), (96, 112), seed=k)]
    for number, frame in enumerate(frames[:11] + frames[12:]):
        tifffile.imwrite(folder / f"im{number:03d}.tif", frame)
    said = evaluated(capsys, folder, tmp_path / "out", *SCALE)
    assert "with hardly any valid vector, the first im010.tif + im011.tif" in said


@pytest.mark.parametrize(
    ("speed_m_s", "width_px", "mm_per_px", "asked"),
    [
        (680.0, 128, 20.0, True), (2e5, 1024, 0.1, True), (1.0, 2048, 100.0, True), (0.0, 512, 1e-5, True),
        (12.0, 2048, 0.05, False), (300.0, 1024, 0.1, False), (1e-5, 1024, 1e-3, False), (0.0, 512, 0.1, False),
    ],
)  # fmt: skip
def test_scale_and_time_are_asked_about_where_vectors_cannot_be_true(speed_m_s, width_px, mm_per_px, asked):
    assert bool(scale_warnings(speed_m_s, width_px, mm_per_px)) == asked


def test_a_scale_that_is_wrong_is_asked_about_in_pairs_and_series(tmp_path, capsys):
    folder = time_resolved(tmp_path / "day", 4)
    wrong = ["--mm-per-px", "20", "--dt-us", "100"]
    assert "faster than sound in air: are the scale" in evaluated(capsys, folder, tmp_path / "out", *wrong)
    frames = [str(folder / f"f{k}.tif") for k in range(2)]
    assert main(["evaluate", *frames, *OPTIONS, *wrong, "-o", str(tmp_path / "two")]) == DONE
    assert "faster than sound in air" in " ".join(capsys.readouterr().out.split())


@pytest.mark.usefixtures("no_mean_page")
def test_a_folder_with_vectors_of_other_frames_is_not_overwritten(tmp_path, capsys):
    one, other = (time_resolved(tmp_path / name, 4) for name in ("one", "other"))
    pair, again = ([str(folder / f"f{k}.tif") for k in range(2)] for folder in (one, other))
    later = [str(one / f"f{k}.tif") for k in range(2, 4)]
    out = tmp_path / "out"
    for first, others in ((pair, (again, later, [str(one)])), ([str(one)], (pair, [str(other)]))):
        words = [*OPTIONS, *SCALE, "-o", str(out)]
        assert main(["evaluate", *first, *words, "--overwrite"]) == DONE
        assert main(["evaluate", *first, *words]) == DONE  # the same once more
        before = {file: file.read_bytes() for file in out.rglob("*") if file.is_file()}
        for frames in others:
            assert main(["evaluate", *frames, *words]) == USAGE
            assert (
                "holds vectors of other frames, or with another time between them; give another folder with -o,"
                in capsys.readouterr().err
            )
        assert {file: file.read_bytes() for file in out.rglob("*") if file.is_file()} == before
    assert main(["mean", str(other), *SCALE, "--workers", "1", "-o", str(out)]) == USAGE
    assert main(["mean", str(one), "--final-window", "32", *SCALE, "--workers", "1", "-o", str(out)]) == DONE


@pytest.mark.usefixtures("no_mean_page")
@pytest.mark.slow
def test_a_mean_with_another_time_between_its_frames_is_kept_beside_the_first(tmp_path, monkeypatch, capsys):
    """The second replaced the first: the same vectors, at twice the speed."""
    day = time_resolved(tmp_path / "day", 4)
    monkeypatch.chdir(tmp_path)
    words = ["mean", str(day), "--final-window", "32", "--workers", "1", "--mm-per-px", "0.1"]

    def speed(folder):
        return float(np.nanmedian(read_vectors(tmp_path / folder / "mean.nc").fields["u"]))

    for dt in ([], ["--dt-us", "1000"], ["--dt-us", "500"], ["--dt-us", "1000"]):
        assert main([*words, *dt]) == DONE
    assert sorted(path.name for path in tmp_path.glob("evaluation*")) == [
        "evaluation", "evaluation-2", "evaluation-3"
    ]  # fmt: skip
    slow, fast = speed("evaluation-2"), speed("evaluation-3")
    assert fast == pytest.approx(2.0 * slow)
    capsys.readouterr()
    for dt in (["--dt-us", "1000"], []):
        before = (tmp_path / "evaluation-3" / "mean.nc").read_bytes()
        assert main([*words, *dt, "-o", "evaluation-3"]) == USAGE
        assert "with another time between them" in capsys.readouterr().err
        assert (tmp_path / "evaluation-3" / "mean.nc").read_bytes() == before
    assert main([*words, "--dt-us", "1000", "-o", "evaluation-3", "--overwrite"]) == DONE
    assert speed("evaluation-3") == pytest.approx(slow)


def test_copies_of_one_pair_are_named_where_their_background_takes_everything(tmp_path):
    same = frames_of(np.random.default_rng(1), (2.0, -1.0))
    run = flow_run(tmp_path, 3, spoiled=dict.fromkeys(range(3), lambda a, b: same))
    for background in ("sliding-minimum", "minimum"):
        with pytest.raises(PairError, match=f"its background, {background}, is taken off: the frames that it was"):
            run_series(series_of(tmp_path / background, given_of(run), method_of(tmp_path, background)), 1)


def test_a_pair_of_one_picture_is_left_out_of_a_series(tmp_path):
    run = flow_run(tmp_path, 4, spoiled={2: lambda a, b: (a, a)})
    books = run_series(series_of(tmp_path / "out", given_of(run), method_of(tmp_path, "sliding-minimum")), 1)
    assert list(books.failed) == [given_of(run).pairs[2].tag]
    assert "frames A and B are the same picture" in next(iter(books.failed.values()))
