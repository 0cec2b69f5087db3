"""Frames that nobody here has taken: one that is damaged, or of another size, costs its pair and nothing else."""

from types import SimpleNamespace

import numpy as np
import pytest
import tifffile

import rtpiv
from ground import terminal
from rtpiv.analysis.pairs.piv_file import piv_choice
from rtpiv.analysis.recipe import CorrectionRecipe
from rtpiv.analysis.report import series as page_of_series
from rtpiv.analysis.report.series import choose_pair
from rtpiv.analysis.series.run_series import run_series
from rtpiv.analysis.series.series_folder import SeriesFolder
from rtpiv.analysis.series.series_input import series_input
from rtpiv.verbs.evaluate import EvaluationOutput, evaluate
from rtpiv.verbs.mean import MeanOutput, mean
from tests.daq.frames.videos import damaged, write_video

PLAIN = CorrectionRecipe(mm_per_px=0.05)
MOVED_PX, DT_US = 3.0, 100.0


def pair(number, height=96, width=128):
    """Particles of their own for every pair, moved to the right."""
    rng = np.random.default_rng(number)
    places = rng.uniform((0, 0), (height, width), (height * width // 40, 2))
    rows, columns = np.mgrid[:height, :width]
    frames = []
    for moved in (0.0, MOVED_PX):
        light = np.zeros((height, width))
        for y, x in places:
            near = np.s_[max(int(y) - 4, 0) : int(y) + 5, max(int(x + moved) - 4, 0) : int(x + moved) + 5]
            light[near] += 150 * np.exp(-((columns[near] - x - moved) ** 2 + (rows[near] - y) ** 2) / 2.0)
        frames.append(np.clip(light, 0, 255).astype(np.uint8))
    return frames


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Four pairs, the third smaller than the others."""
    monkeypatch.setattr(terminal, "_said", set())
    (tmp_path / "day1").mkdir()
    for number in range(4):
        for second, frame in enumerate(pair(number, 64 if number == 2 else 96)):
            tifffile.imwrite(tmp_path / "day1" / f"im{2 * number + second}.tif", frame)
    return tmp_path / "day1"


def right(found):
    """What moved, in m/s: 3 px of 0.05 mm in 100 us."""
    return np.median(found.mean_m_s[..., 0][np.isfinite(found.mean_m_s[..., 0])]) == pytest.approx(1.5, abs=0.03)


def test_frames_of_another_size_cost_their_own_pair(tmp_path, folder, capsys):
    found = mean(folder, out=tmp_path / "s", recipe=PLAIN, output=MeanOutput(files=False), dt_us=DT_US, workers=1)
    assert found.used == 3
    assert right(found)
    assert "im4.tif: is 128 x 64 px, and 128 x 96 px are expected" in " ".join(capsys.readouterr().out.split())


@pytest.mark.slow
def test_a_damaged_frame_of_a_video_costs_its_own_pair(tmp_path, capsys):
    pytest.importorskip("av")
    shown = np.array([frame for number in range(4) for frame in pair(number)])
    video = damaged(write_video(tmp_path / "run.avi", shown, "png", "gray"), 3)
    found = mean(video, out=tmp_path / "s", recipe=PLAIN, dt_us=DT_US, workers=1)
    assert found.used == 3
    assert right(found)
    said = " ".join(capsys.readouterr().out.split())
    assert "broken.avi@3 + broken.avi@4 is left out:" in said
    assert "broken.avi@3: is damaged, or made from a frame that is" in said
    assert (tmp_path / "s" / "mean.html").is_file()


def test_two_frames_of_a_video_are_a_pair_as_they_are(tmp_path):
    pytest.importorskip("av")
    video = write_video(tmp_path / "run.mp4", np.array(pair(0)), "libx264", "yuv420p", crf=10)
    names = [video.with_name(f"run.mp4@{number}") for number in (1, 2)]
    with terminal.silence():
        found = evaluate(names, out=tmp_path / "s", recipe=PLAIN, output=EvaluationOutput(pictures=False))
    field = found.details[0].field
    assert np.median(field.u_px[field.valid]) == pytest.approx(MOVED_PX, abs=0.05)
    with pytest.raises(rtpiv.ERRORS, match="frames 1 to 2, and no 3"):
        evaluate([names[0], video.with_name("run.mp4@3")], out=tmp_path / "t", recipe=PLAIN)


@pytest.mark.slow
def test_a_page_that_would_show_the_same_is_not_drawn_again(tmp_path, folder, monkeypatch):
    drawn, out = [], tmp_path / "s"

    def write(path, *given):
        drawn.append(path)
        path.write_text(f"page {len(drawn)}")

    monkeypatch.setattr("rtpiv.analysis.report.mean.write_mean_page", write)

    def again(**options):
        with terminal.silence():
            found = mean(folder, out=out, recipe=PLAIN, dt_us=DT_US, workers=1, **options)
        assert right(found)
        return len(drawn), (out / "mean.html").read_bytes()

    count, first = again()
    assert (count, again()) == (1, (1, first))
    assert again(sigma_w_m_s=0.3)[0] == 2  # another sigma
    assert again()[0] == 3
    (out / "mean.html").write_text("cut")
    assert again()[0] == 4
    (out / "mean.json").write_text("{")
    assert again()[0] == 5
    tifffile.imwrite(folder / "im0.tif", pair(9)[0])
    tifffile.imwrite(folder / "im1.tif", pair(9)[1])
    assert again()[0] == 6  # other vectors
    assert again()[0] == 6


def test_the_pair_on_a_page_has_the_vectors_of_its_file(tmp_path, folder, monkeypatch):
    """In the single precision of that; only where its light stands still, which a file tells in part, not."""
    with terminal.silence():
        given = series_input(folder, tmp_path / "s", piv_choice(), recipe=PLAIN, dt_us=DT_US)
        done = run_series(given, 1)
    with monkeypatch.context() as stands:
        kept = SimpleNamespace(fields=[SimpleNamespace(static_share=0.07)] * len(given.given.pairs))
        stands.setattr(SeriesFolder, "chunk", lambda *given: kept)
        expected = choose_pair(given, done)
    monkeypatch.setattr(page_of_series, "correlate_pair", None)
    found = choose_pair(given, done)
    assert found.tag == expected.tag
    assert found.field.warning == expected.field.warning
    assert found.field.static_share == pytest.approx(expected.field.static_share, rel=1e-6, nan_ok=True)
    for name in ("x_px", "y_px", "u_px", "v_px", "sigma_u_px", "sigma_v_px", "flags"):
        one, other = getattr(found.field, name), getattr(expected.field, name)
        np.testing.assert_allclose(one, other, rtol=2e-7, atol=0.0)


def test_pairs_that_a_camera_repeats_or_somebody_exchanges_are_named(tmp_path, capsys):
    repeated, one_picture, exchanged = 2, 4, 6
    (tmp_path / "day2").mkdir()
    for number in range(8):
        first, second = pair(number - 1 if number == repeated else number)
        if number == exchanged:
            first, second = second, first
        for letter, frame in (("a", first), ("b", first if number == one_picture else second)):
            tifffile.imwrite(tmp_path / "day2" / f"im{number}_{letter}.tif", frame)
    found = mean(
        tmp_path / "day2", out=tmp_path / "s", recipe=PLAIN, output=MeanOutput(files=False), dt_us=DT_US, workers=1
    )
    said = " ".join(capsys.readouterr().out.split())
    assert found.used == 6
    assert "im2_a.tif + im2_b.tif is left out: both frames are, pixel by pixel, those of an earlier pair" in said
    assert "im4_a.tif + im4_b.tif is left out: frames A and B are the same picture" in said
    assert "1 pair moved as far as the others the opposite way (im6_a.tif + im6_b.tif)" in said
    assert "was a frame lost" not in said
