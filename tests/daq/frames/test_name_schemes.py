"""Names of frames as public data sets, programs and labs give them: right pairs, or advice that leads to them."""

import re
import shlex
from pathlib import Path

import numpy as np
import pytest
import tifffile

from daq.frames.double_frames import part_of
from daq.frames.likeness import layout_of, likeness, require_pairs
from daq.frames.numbered_files import WITH, first_pairs
from daq.frames.source import is_source, source_of
from piv.errors import PairError
from rtpiv.command_line.cli import DONE, USAGE, main
from tests.loops import loop_over
from tests.piv.conftest import make_pair

N = range(1, 5)


def pairs_by(first, second, numbers=N):
    return [(first.format(n), second.format(n)) for n in numbers]


def sequence(name, numbers):
    names = [name.format(n) for n in numbers]
    return list(zip(names[::2], names[1::2], strict=True))


# What a program or set of data calls its frames: pairs, and what else lies in the folder
SCHEMES = {
    "PIV challenge": (pairs_by("A{:03d}_1.tif", "A{:03d}_2.tif"), []),
    "PIV challenge, 0 first": (pairs_by("B{:05d}_0.tif", "B{:05d}_1.tif"), []),
    "frames 0 and 1": (pairs_by("img{:04d}_frame0.tif", "img{:04d}_frame1.tif"), []),
    "letter in front": (pairs_by("a{:04d}.tif", "b{:04d}.tif"), []),
    "capital in front": (pairs_by("A{:04d}.bmp", "B{:04d}.bmp"), []),
    "Insight": (pairs_by("jet{:06d}.T000.D000.P003.H001.LA.tif", "jet{:06d}.T000.D000.P003.H001.LB.tif"), []),
    "dash": (pairs_by("x{:d}-a.png", "x{:d}-b.png"), []),
    "letter in the middle": (pairs_by("img_a_{:04d}.jpg", "img_b_{:04d}.jpg"), []),
    "one camera of many": (pairs_by("Cam1_{:04d}A.tif", "Cam1_{:04d}B.tif"), []),
    "OpenPIV": (pairs_by("exp1_{:03d}_a.bmp", "exp1_{:03d}_b.bmp"), []),
    "PIVlab": (pairs_by("PIVlab_{:04d}_A.jpg", "PIVlab_{:04d}_B.jpg"), []),
    "frame before number": (pairs_by("frame1_{:03d}.tif", "frame2_{:03d}.tif"), []),
    "frameA": (pairs_by("frameA_{:02d}.tif", "frameB_{:02d}.tif"), []),
    "pulses": (pairs_by("shot{:d}_pulse1.tiff", "shot{:d}_pulse2.tiff"), []),
    "words": (pairs_by("{:03d}_first.tif", "{:03d}_second.tif"), []),
    "two digits": (pairs_by("run7_{:03d}_01.tif", "run7_{:03d}_02.tif"), []),
    "dots": (pairs_by("vortex.{:04d}.0.pgm", "vortex.{:04d}.1.pgm"), []),
    "equals": (pairs_by("n={:d} f=0.tif", "n={:d} f=1.tif"), []),
    "subfolders": (pairs_by("A/{:04d}.tif", "B/{:04d}.tif"), []),
    "subfolders with words": (pairs_by("frame0/im{:04d}.tif", "frame1/im{:04d}.tif"), []),
    "one pair": ([("A001_1.tif", "A001_2.tif")], []),
    "one pair, no number": ([("a.tif", "b.tif")], []),
    "a folder of each pair": (pairs_by("pair{:03d}/a.tif", "pair{:03d}/b.tif"), []),
    "Roman numbers": (pairs_by("p{:03d}_I.tif", "p{:03d}_II.tif"), []),
    "before and after": (pairs_by("{:03d}_before.png", "{:03d}_after.png"), []),
    "endings of both sizes": (pairs_by("jet{:03d}_A.TIF", "jet{:03d}_B.tif"), []),
    "a sequence copied twice": ([("im1.tif", "im2.TIF"), ("im3.TIF", "im4.tif")], []),
    "Karman": ([("karman_01.bmp", "karman_02.bmp")], []),
    "numbers": (sequence("im{:04d}.tif", range(8)), []),
    "numbers of any width": (sequence("im{:d}.tif", range(7, 15)), []),
    "steps of ten": (sequence("im{:05d}.tif", range(0, 80, 10)), []),
    "seconds": (sequence("t={:.4f}s.tif", [k * 1e-3 for k in range(8)]), []),
    "milliseconds, rounded": (sequence("jet_{:04d}ms.tif", [round(k * 33.33) for k in range(8)]), []),
    "bursts in microseconds": (sequence("{:09d}us.tif", [k * 20000 + d for k in range(4) for d in (0, 150)]), []),
    "date and time": (sequence("2024-03-12_10-{0[0]:d}-{0[1]:03d}.tif", [divmod(701 * k, 1000) for k in N]), []),
    "macOS": (sequence("im{:04d}.tif", range(6)), [f"._im{k:04d}.tif" for k in range(6)]),
    "a stray target": (sequence("im{:04d}.tif", range(12)), ["target_01.tif", "notes.txt"]),
    "a stray mask in pairs": (pairs_by("B{:05d}_a.tif", "B{:05d}_b.tif", range(12)), ["mask2.png", ".DS_Store"]),
    "per cent and d": (pairs_by("50 %d {:03d}_a.tif", "50 %d {:03d}_b.tif"), []),
    "high-speed camera, trigger in the middle": (sequence("jet{:+06d}.tif", range(-4, 4)), []),
    "the same with a minus alone": (sequence("jet{:d}.tif", range(-6, 2)), []),
    "all before the trigger": (sequence("t={:d}us.tif", range(-8, 0)), []),
    "a dash, as zero has no sign": (sequence("run-2_-{:03d}.tif", range(8)), []),
    "hexadecimal": (sequence("f_{:04x}.tif", range(40)), []),
    "hexadecimal in capitals": (sequence("1A{:02X}.png", range(8, 18)), []),
    "a counter that began anew": (sequence("im{:03d}.tif", [*range(995, 1000), *range(7)]), []),
    "the same without zero": (sequence("im{:03d}.tif", [*range(994, 1000), *range(1, 7)]), []),
    "a counter of 8 bits": (sequence("im_{:d}.tif", [*range(251, 256), *range(7)]), []),
    "numbers alone, with signs": (sequence("{:d}.png", range(-4, 4)), ["mask.png"]),
    "trigger in a short series": (sequence("run=3_{:d}.tif", range(-2, 2)), []),
    "times about 1 s": (sequence("t={}.tif", [f"{k / 4}".replace(".", ",") for k in range(1, 9)]), []),
    "times through 1 with a unit": (sequence("jet {:.2f}ms.tif", [k * 0.25 for k in range(8)]), []),
    "a mark in front of a point": (pairs_by("im0.{:04d}.tif", "im1.{:04d}.tif"), []),
    "decimal comma": (sequence("t={}s.tif", ["0,1", "0,15", "0,2", "0,25", "0,3", "0,35", "0,4", "0,45"]), []),
    "p for a point": (sequence("t{}.png", ["0p1", "0p15", "0p2", "0p25", "0p3", "0p35"]), []),
    "exponents": (sequence("t_{:.1e}.tif", [k * 2e-4 for k in range(1, 9)]), []),
    "steps behind a point": (sequence("x2.{:d}.tif", range(7, 23, 2)), []),
    "steps behind a point, none ends in 0": (sequence("t1.{:d}.png", range(7, 47, 5)), []),
    "numbers with points": (sequence("run3.{:d}.tif", range(3, 13)), []),
    "a mask beside one pair": ([("bubblesA.png", "bubblesB.png")], ["bubblesMask.png"]),
    "mask and dark frame beside one": ([("t23_1.tif", "t23_2.tif")], ["mask.tif", "dark_5.tif", "scale.jpg"]),
    "copies by a file manager": (sequence("im{:03d}.tif", range(6)), ["im003 - Copy.tif", "im002 (1).tif"]),
    "start and end": (pairs_by("{:03d}_start.tif", "{:03d}_end.tif"), []),
    "one and two": (pairs_by("Laser_One_{:04d}.tif", "Laser_Two_{:04d}.tif"), []),
    "other letters": (pairs_by("Strömung_{:03d}_1.tif", "Strömung_{:03d}_2.tif"), []),
}  # fmt: skip


def lay(folder, pairs, others=()):
    for name in (*(name for pair in pairs for name in pair), *others):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(b"")
    return folder


def found_in(path, folder):
    return [tuple(str(place.relative_to(folder)) for place in places) for _, *places in source_of(path).pairs()]


def test_schemes_of_names_give_the_right_pairs(tmp_path):
    assert len(SCHEMES) > 30
    for name, (pairs, others) in SCHEMES.items():
        folder = lay(tmp_path / name, pairs, others)
        assert is_source(folder), name
        assert found_in(folder, folder) == pairs, name
        assert source_of(folder).count_unpaired() == 0, name


def test_lost_frames_cost_their_own_pairs(tmp_path):
    for name, (pairs, others) in SCHEMES.items():
        if len(pairs) < 4 or name == "date and time":  # whose order alone is known
            continue
        folder = lay(tmp_path / name, pairs, others)
        (folder / pairs[1][0]).unlink()
        left = [pair for pair in pairs if pair != pairs[1]]
        assert found_in(folder, folder) == left, name
        assert source_of(folder).count_unpaired() == 1, name


@pytest.mark.parametrize("form", ["Cam_-{:06d}.tif", "-{:d}.png", "run-1_-{:03d}a.tif"])
def test_a_minus_before_every_number_is_asked_for(form, tmp_path):
    """It was a sign: frames that a dash numbers were paired in reverse, every velocity turned round."""
    folder = lay(tmp_path, sequence(form, range(1, 9)))
    with pytest.raises(PairError, match="may be a sign or a dash") as refused:
        source_of(folder)
    found = [found_in(Path(path), folder) for (path,) in ways_of(refused.value)]
    assert found == [sequence(form, range(1, 9)), sequence(form, range(8, 0, -1))]


# Folders that can be read in several ways: what is right is among the commands that the refusal names
SEVERAL = {
    "two cameras": pairs_by("im{:05d}_cam1.tif", "im{:05d}_cam2.tif"),
    "two cameras by letter": pairs_by("camA_{:04d}.tif", "camB_{:04d}.tif"),
    "two runs": pairs_by("run1_{:04d}.tif", "run2_{:04d}.tif"),
    "planes": pairs_by("z1_{:04d}.tif", "z2_{:04d}.tif"),
}
BY_NUMBER = {
    "numbers apart": [(f"Pattern_{k:04d}_A.tif", f"Pattern_{k + 1000:04d}_B.tif") for k in N],
    "one behind the other": [(f"im{2 * k:03d}a.tif", f"im{2 * k + 1:03d}b.tif") for k in N],
    "counters behind a point": pairs_by("B_1.{:04d}.tif", "B_2.{:04d}.tif"),
    "ordinals": pairs_by("{:03d}_1st.tif", "{:03d}_2nd.tif"),
    "words of no list": pairs_by("{:03d}_davor.tif", "{:03d}_nachher.tif"),
}
ALL_WAYS = {
    "one pair of each case": ([("A001_1.tif", "A001_2.tif")], [("B001_1.tif", "B001_2.tif")]),
    "two series": (pairs_by("jet_{:03d}_a.tif", "jet_{:03d}_b.tif"), pairs_by("w_{:03d}_a.tif", "w_{:03d}_b.tif")),
    "cases A and B": (pairs_by("A{:03d}_1.tif", "A{:03d}_2.tif"), pairs_by("B{:03d}_1.tif", "B{:03d}_2.tif")),
    "two cameras in pairs": (
        pairs_by("Cam1_{:04d}A.tif", "Cam1_{:04d}B.tif"), pairs_by("Cam2_{:04d}A.tif", "Cam2_{:04d}B.tif"),
    ),
}  # fmt: skip


def ways_of(error):
    """The words that a refusal says to give, one list a way."""
    return [shlex.split(way) for way in re.findall(r'"[^"]+"(?: --second "[^"]+")?', str(error))]


def test_advice_of_a_refusal_followed_literally_gives_the_right_pairs(tmp_path):
    for name, pairs in SEVERAL.items():
        folder = lay(tmp_path / name, pairs)
        with pytest.raises(PairError, match="name one of them, in quotes") as refused:
            source_of(folder)
        firsts = [first for first, _ in pairs]
        found = [found_in(Path(path), folder) for (path,) in ways_of(refused.value)]
        assert [list(zip(firsts[::2], firsts[1::2], strict=True))] == found[:1], name
        assert len(found) == 2, name
    for name, series in ALL_WAYS.items():
        folder = lay(tmp_path / name, [pair for pairs in series for pair in pairs])
        with pytest.raises(PairError, match="several") as refused:
            source_of(folder)
        ways = ways_of(refused.value)
        found = [found_in(Path(WITH.join((first, second))), folder) for first, _, second in ways[: len(series)]]
        assert found == list(series), name
    for name, pairs in BY_NUMBER.items():
        folder = lay(tmp_path / name, pairs)
        with pytest.raises(PairError, match="first and second frames of pairs") as refused:
            source_of(folder)
        first, _, second = ways_of(refused.value)[-1]
        assert found_in(Path(WITH.join((first, second))), folder) == pairs, name
    folder = lay(tmp_path / "four exposures", [("a.tif", "b.tif"), ("c.tif", "d.tif")])
    with pytest.raises(PairError, match="several") as refused:
        source_of(folder)
    assert [[Path(word).name for word in way] for way in ways_of(refused.value)] == [["a.tif"], ["b.tif"]]


def test_a_pattern_of_first_frames_has_their_partners(tmp_path):
    folder = lay(tmp_path / "day", pairs_by("A{:03d}_1.tif", "A{:03d}_2.tif"))
    right = pairs_by("A{:03d}_1.tif", "A{:03d}_2.tif")
    for pattern in (
        "A%03d_1.tif",
        "A%d_1.tif",
        "A*_1.tif",
        f"A*_1.tif{WITH}A*_2.tif",
        f"A%03d_1.tif{WITH}A%03d_2.tif",
    ):
        assert found_in(folder / pattern, folder) == right, pattern
    with pytest.raises(PairError, match="second frames") as refused:
        source_of(folder / "A%03d_2.tif")
    ((words),) = ways_of(refused.value)
    assert found_in(Path(words[0]), folder) == right
    swapped = [(second, first) for first, second in right]
    assert found_in(folder / f"A%03d_2.tif{WITH}A%03d_1.tif", folder) == swapped  # who says so gets it
    assert "A001_1.tif + A001_2.tif" in first_pairs(source_of(folder).pairs())
    for wrong in (f"A%03d_1.tif{WITH}C%03d_2.tif", f"A%03d_1.tif{WITH}A001_2.tif"):
        with pytest.raises(PairError):
            source_of(folder / wrong)


def test_second_frames_in_another_folder(tmp_path):
    pairs = pairs_by("early/im{:03d}.tif", "late/im{:03d}.tif")
    folder = lay(tmp_path, pairs)
    assert found_in(Path(f"{folder / 'early/im%03d.tif'}{WITH}{folder / 'late/im%03d.tif'}"), folder) == pairs


def moved(seed, shift=(3.0, 1.0), shape=(96, 112)):
    return make_pair(lambda u, v: shift, shape, seed=seed)


def interlaced(a, b):
    both = a.copy()
    both[1::2] = b[1::2]
    return both


JOINED = {"top-bottom": lambda a, b: np.vstack((a, b)), "left-right": lambda a, b: np.hstack((a, b)),
          "interlaced": interlaced}  # fmt: skip


@loop_over("layout", JOINED)
@loop_over("shift", [(3.0, 0.5), (-7.0, 4.0), (0.3, 5.0), (12.0, -9.0)])
def test_both_exposures_in_one_file_are_found(layout, shift):
    one, other = (JOINED[layout](*moved(seed, shift)) for seed in (1, 2))
    across, _ = likeness(one, other)
    assert layout_of(one, other, across) == layout


@pytest.mark.parametrize("shift", [(0.0, 0.0), (0.4, 2.0), (8.0, -3.0)])
def test_frames_of_one_exposure_are_not_taken_for_two(shift):
    a, b = moved(3, shift)
    c, _ = moved(4, shift)
    for one, other in ((a, b), (a, c), (b, c), (a[::-1], c)):
        assert layout_of(one, other, likeness(one, other)[0]) is None


def write(folder, frames, name="im{:04d}.tif"):
    folder.mkdir(parents=True)
    for number, frame in enumerate(frames):
        tifffile.imwrite(folder / name.format(number), frame, photometric="minisblack")
    return folder


def test_parts_of_a_file_have_their_own_rows():
    a, b = moved(5)
    for layout, join in JOINED.items():
        parts = {
            "top-bottom": ("top", "bottom"),
            "left-right": ("left", "right"),
            "interlaced": ("rows1", "rows2"),
        }[layout]
        one, other = (part_of(join(a, b), part) for part in parts)
        if layout == "interlaced":
            np.testing.assert_array_equal(one[::2], a[::2])
            np.testing.assert_array_equal(other[1::2], b[1::2])
            assert one.shape == a.shape
        else:
            np.testing.assert_array_equal(one, a)
            np.testing.assert_array_equal(other, b)
    assert part_of(np.zeros((5, 4)), "top").shape == part_of(np.zeros((5, 4)), "bottom").shape == (2, 4)


OPTIONS = ["--mm-per-px", "0.1", "--dt-us", "100", "--final-window", "32", "--no-pictures", "--workers", "1"]


def followed(words, capsys, out):
    """Medians of the series [px] that a command gives."""
    from piv.files.vector_file import read_vectors

    assert main(["evaluate", *words, *OPTIONS, "-o", str(out)]) == DONE, capsys.readouterr().err
    vectors = [read_vectors(file) for file in sorted((out / "chunks").glob("*.nc"))]
    return np.nanmedian(np.concatenate([v.fields["displacement_x"] for v in vectors]), axis=(1, 2))


def test_a_folder_of_double_frames_is_refused_and_evaluated_as_is_said(tmp_path, capsys):
    shifts = (2.0, 3.0, 4.0)
    frames = [interlaced(*moved(k, (u, 2.5))) for k, u in enumerate(shifts)]
    folder = write(tmp_path / "day ä", frames)
    assert main(["evaluate", str(folder), *OPTIONS, "-o", str(tmp_path / "wrong")]) == USAGE
    advice = re.search(r"give (--both \S+)", capsys.readouterr().err)
    assert advice is not None
    for where in (folder, folder / "im%04d.tif"):
        found = followed([str(where), *advice[1].split()], capsys, tmp_path / f"out {where.name}")
        np.testing.assert_allclose(found, shifts, atol=0.1)
        assert "im0000.tif@" in capsys.readouterr().out


def test_a_folder_of_files_with_two_pages(tmp_path, capsys):
    folder = write(tmp_path / "day", [np.stack(moved(k, (k + 2.0, 1.0))) for k in range(3)], "B{:05d}.tif")
    np.testing.assert_allclose(followed([str(folder)], capsys, tmp_path / "out"), (2.0, 3.0, 4.0), atol=0.1)
    other = write(tmp_path / "three", [np.stack((*moved(k), moved(k)[0])) for k in range(3)])
    assert main(["evaluate", str(other), *OPTIONS, "-o", str(tmp_path / "o")]) == USAGE
    assert "holds 3 pages" in capsys.readouterr().err


def test_a_sequence_that_lost_its_first_frame(tmp_path, capsys):
    folder = write(tmp_path / "day", [frame for k in range(4) for frame in moved(k)][1:])
    assert main(["evaluate", str(folder), *OPTIONS, "-o", str(tmp_path / "wrong")]) == USAGE
    advice = re.search(r'give "(.+?)"', capsys.readouterr().err)
    assert advice is not None
    found = followed([advice[1]], capsys, tmp_path / "out")
    np.testing.assert_allclose(found, (3.0, 3.0, 3.0), atol=0.1)
    require_pairs(folder, source_of(Path(advice[1])).pairs())


def test_frames_that_are_no_pairs_are_an_error_and_can_be_kept(tmp_path, capsys):
    """The pairs share a strip on the left, which has few valid vectors, and those can be averaged."""
    frames = []
    for k in range(3):
        (a, b), other = moved(k), moved(k + 3)[0]
        frames += [a, np.where(np.arange(a.shape[1]) < 32, b, other)]
    folder = write(tmp_path / "day", frames)
    words = ["evaluate", str(folder), *OPTIONS, "-o", str(tmp_path / "out")]
    assert main(words) == USAGE
    said = capsys.readouterr()
    assert "windows have a valid vector" in said.err
    assert "im0000.tif + im0001.tif" in said.out
    assert main([*words, "--least-valid", "0"]) == DONE
    told = " ".join(capsys.readouterr().out.split())
    assert re.search(r"only \d+ % of the windows have a valid vector, so these may be no pairs; 3 of 3", told)


def test_copies_of_frames_are_named_and_pairs_beside_them_count(tmp_path, capsys):
    frames = [*moved(0), *(moved(k)[0] for k in (1, 1, 2, 2))]
    words = ["evaluate", str(write(tmp_path / "day", frames)), *OPTIONS, "-o", str(tmp_path / "out")]
    assert main(words) == DONE
    said = " ".join("".join(capsys.readouterr()).split())
    assert "1 of 3 pairs have vectors" in said
    assert "im0002.tif + im0003.tif" in said
    assert "are the same picture" in said


@pytest.mark.parametrize(
    ("files", "given", "advice"),
    [
        (["jet.avi", "notes.txt"], ".", 'give what lies in it: "{}/jet.avi"'),
        (["day_1.im7", "day_2.im7"], ".", 'give what lies in it: "{}/day_1.im7"'),
        (["flow.mraw", "flow.cihx", "x.cihx"], ".", "its files: 2 of .cihx, 1 of .mraw"),
        ([], ".", "its files: none at all"),
        (["left.tif", "other.png"], ".", 'give two frames by their names, such as "{0}/left.tif" "{0}/other.png"'),
        (["a.ppm", "b.ppm"], "a.ppm", "files .ppm are not read; convert its frames to TIFF"),
        (["a.png"], "a.png", "it is one frame; give two frames, or one folder"),
        (["a.tif"], "b", "it does not exist"),
    ],
)
@pytest.mark.parametrize("verb", ["evaluate", "mean"])
def test_what_is_no_source_is_refused_with_what_to_give(verb, files, given, advice, tmp_path, capsys):
    for name in files:
        (tmp_path / name).write_bytes(b"")
    assert main([verb, str(tmp_path / given), "-o", str(tmp_path / "out")]) == USAGE
    assert advice.format(tmp_path) in " ".join(capsys.readouterr().err.split())


def test_unrelated_frames_are_an_error_and_have_no_mean(tmp_path, capsys):
    folder = write(tmp_path / "day", [moved(k)[0] for k in range(6)])
    for verb, kept in (("evaluate", DONE), ("mean", USAGE)):
        words = [verb, str(folder), *OPTIONS[: 6 if verb == "mean" else None], "-o", str(tmp_path / verb)]
        assert main(words) == USAGE
        assert "only 0 % of the windows have a valid vector" in " ".join(capsys.readouterr().err.split())
        assert main([*words, "--least-valid", "0"]) == kept
    assert "no pair of this series has a vector" in capsys.readouterr().err


def test_second_frames_by_an_option_or_as_a_second_pattern(tmp_path, capsys):
    folder = tmp_path / "day"
    folder.mkdir()
    for k in range(3):
        for name, frame in zip((f"A{k:03d}_1.tif", f"C{k:03d}_x.tif"), moved(k, (k + 2.0, 1.0)), strict=True):
            tifffile.imwrite(folder / name, frame)
    first, second = str(folder / "A%03d_1.tif"), str(folder / "C%03d_x.tif")
    for number, words in enumerate(
        ([first, "--second", "C%03d_x.tif"], [first, second], [first, "--second", second])
    ):
        found = followed(words, capsys, tmp_path / f"out{number}")
        np.testing.assert_allclose(found, (2.0, 3.0, 4.0), atol=0.1)
    single = [str(folder / "A000_1.tif"), str(folder / "C000_x.tif")]
    both = ["--both", "left-right"]
    for words in ([*single, "--second", second], [*single, *both], [first, "--second", second, *both]):
        assert main(["evaluate", *words, *OPTIONS, "-o", str(tmp_path / "no")]) == USAGE
        assert "--second and --both are for one folder or pattern" in capsys.readouterr().err


def test_a_single_file_with_both_exposures(tmp_path, capsys):
    folder = write(tmp_path / "day", [np.vstack(moved(1, (4.0, 2.0)))])
    words = [str(folder / "im0000.tif"), "--both", "top-bottom", "--prepare", "none"]
    np.testing.assert_allclose(followed(words, capsys, tmp_path / "out"), [4.0], atol=0.1)
