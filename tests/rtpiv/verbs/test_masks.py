"""A bright wall that a mask leaves out: vectors beside it are those that there would be without a wall."""

import cv2
import numpy as np
import pytest
import tifffile

from ground import terminal
from rtpiv.analysis.recipe import CorrectionRecipe
from rtpiv.command_line.cli import USAGE, main
from rtpiv.verbs.evaluate import EvaluationOutput, evaluate
from rtpiv.verbs.mean import MeanOutput, mean
from tests.piv.conftest import make_pair
from tracer.scene.scene_file import load_scene

H, W, WALL_ROW, WINDOW_PX = 160, 192, 112, 16
SHIFT = (2.6, -1.3)
MM = 0.05


def textured_wall(frame):
    """What stands still, ten times as bright as particles, from a row on."""
    rng = np.random.default_rng(9)
    texture = np.clip(2.0 * cv2.GaussianBlur(rng.normal(size=frame.shape), (0, 0), 1.2) + 1.0, 0.2, 2.0)
    covered = frame.astype(float)
    covered[WALL_ROW:] = 2000.0 * texture[WALL_ROW:]
    return np.clip(covered, 0, 4095).astype(np.uint16)


@pytest.fixture(scope="module")
def day(tmp_path_factory):
    folder = tmp_path_factory.mktemp("day")
    picture = np.zeros((H, W), np.uint8)
    picture[WALL_ROW:] = 255
    cv2.imwrite(str(folder / "mask.png"), picture)
    cv2.imwrite(str(folder / "small.png"), picture[:, :-2])
    for name, covered in (("free", lambda frame: frame), ("wall", textured_wall)):
        (folder / name).mkdir()
        for number in range(3):
            for second, frame in enumerate(make_pair(lambda u, v: SHIFT, (H, W), seed=number)):
                tifffile.imwrite(
                    folder / name / f"im{2 * number + second}.tif", covered(np.asarray(frame, np.uint16))
                )
    return folder


def errors_beside(day, out, name, mask):
    """Error of u and v (pair, row, column) of windows that reach the wall's row or end within one window of it.

    None stands on the edge of the wall, 0.5 px before its row.
    """
    found = []
    recipe = CorrectionRecipe(mm_per_px=MM, mask=day / "mask.png" if mask else None)
    for number in range(3):
        frames = [day / name / f"im{2 * number + second}.tif" for second in (0, 1)]
        with terminal.silence():
            field = (
                evaluate(
                    frames, out=out / f"{name}{mask}{number}", recipe=recipe,
                    output=EvaluationOutput(pictures=False), final_window_px=WINDOW_PX,
                )
                .details[0]
                .field
            )  # fmt: skip
        near = (field.y_px < WALL_ROW - 1) & (field.y_px > WALL_ROW - 2 * WINDOW_PX)
        error = np.stack((field.u_px - SHIFT[0], field.v_px - SHIFT[1]))[:, near]
        found.append(np.where(field.valid[near], error, np.nan))
        assert not field.valid[field.y_px > WALL_ROW - 1].any() or not mask
    return np.array(found)


@pytest.mark.slow
def test_a_masked_wall_gives_no_bias_beside_it(day, tmp_path):
    free, wall, masked = (
        errors_beside(day, tmp_path, name, mask)
        for name, mask in (("free", False), ("wall", False), ("wall", True))
    )
    assert np.median(abs(wall[np.isfinite(wall)])) < 0.03  # found where no mask is given
    assert np.isfinite(wall).mean() < np.isfinite(masked).mean()  # and a mask leaves more
    for component in (0, 1):
        per_row = [np.nanmean(each[:, component], axis=(0, 2)) for each in (masked, free)]
        scatter = np.nanstd(masked[:, component], axis=(0, 2)) / np.sqrt(
            np.isfinite(masked[:, component]).sum((0, 2))
        )
        assert (abs(per_row[0] - per_row[1]) < np.maximum(4.0 * scatter, 0.005)).all()
        assert abs(per_row[0]).max() < 0.03
    assert np.isfinite(masked).mean() > 0.98
    assert np.nanmax(abs(masked)) < 0.1  # on the very edge of the mask vectors were off by up to 0.9 px
    without = errors_beside(day, tmp_path, "free", True)  # the mask alone, and nothing bright under it
    np.testing.assert_allclose(masked, without, atol=0.01)


def test_a_series_keeps_its_mask_where_its_picture_is_gone(day, tmp_path):
    (tmp_path / "mask.png").write_bytes((day / "mask.png").read_bytes())
    recipe, files = CorrectionRecipe(mm_per_px=MM, mask=tmp_path / "mask.png"), MeanOutput(files=False)
    with terminal.silence():
        found = mean(day / "wall", out=tmp_path / "s", recipe=recipe, output=files, dt_us=200.0, workers=1)
        (tmp_path / "mask.png").unlink()
        again = mean(tmp_path / "s", output=files)
    measured = np.isfinite(found.mean_m_s[..., 0])  # y upwards; 8 px apart, from 7.5 px on
    row_px = 7.5 + 8.0 * np.arange(len(measured))[::-1]
    assert measured[row_px < WALL_ROW - 1].all()
    assert not measured[row_px > WALL_ROW - 1].any()
    np.testing.assert_array_equal(again.mean_m_s, found.mean_m_s)
    assert [part.why for part in load_scene(tmp_path / "s" / "scene.yaml").left_out] == ["left out"]


def test_a_mask_of_another_size_is_refused(day, tmp_path, capsys):
    told = ["--mm-per-px", str(MM), "--dt-us", "200", "--mask", str(day / "small.png"), "-o", str(tmp_path / "s")]
    for given in ([str(day / "wall")], [str(day / "wall" / f"im{n}.tif") for n in (0, 1)]):
        assert main(["evaluate", *given, *told]) == USAGE
        said = capsys.readouterr().err
        assert "small.png: is 190 x 160 px, and the camera 192 x 160; draw it on one of its frames" in said
        assert len(said.strip().splitlines()) == 1
        assert not (tmp_path / "s" / "chunks").exists()
