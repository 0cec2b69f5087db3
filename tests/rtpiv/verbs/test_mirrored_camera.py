"""A camera that looks by a mirror, from its target to its vectors: they point where the flow went."""

import numpy as np
import pytest
import tifffile
import yaml

from piv.files.vector_file import read_vectors
from rtpiv.command_line.cli import DONE, main
from sim.renderer.patterns import Chessboard as Print
from sim.renderer.render import render
from sim.renderer.sensor import Sensor
from tests.piv.conftest import make_pair
from tests.slow_cases import slow
from tracer.board import CHIRAL
from tracer.camera import Camera, look_at
from tracer.scene.scene import Scene
from tracer.scene.scene_file import dump_scene

SIZE_PX, FOCAL_PX, AWAY_MM, DT_US = (320, 272), 1600.0, 300.0, 200.0
SHIFT_PX = 3.2, -1.7  # of the flow in a camera without a mirror, u to the right and v down
MM = AWAY_MM / FOCAL_PX


def camera(x_mm, y_mm):
    middle = ((SIZE_PX[0] - 1) / 2.0, (SIZE_PX[1] - 1) / 2.0)
    place = (x_mm, y_mm, AWAY_MM)
    return Camera(FOCAL_PX, middle, SIZE_PX, place, look_at(place, (x_mm, y_mm, 0.0), 0.0))


@pytest.mark.parametrize(
    "flip",
    [slow(lambda image: image), lambda image: image[:, ::-1], slow(lambda image: image[::-1])],
    ids=["", "x", "y"],
)
def test_vectors_of_a_mirrored_camera_point_where_the_flow_went(tmp_path, flip, monkeypatch):
    """The mirror is in the frames alone, which are reversed; the scene file says it, for ReverseY with a roll."""
    monkeypatch.chdir(tmp_path)
    is_plain = flip(np.array([[0, 1], [2, 3]])).tolist() == [[0, 1], [2, 3]]
    board = render(Scene(camera(0.7, -0.4), ()), Print(3.0, 1.2, discs=CHIRAL), Sensor(), samples=2, seed=1)
    pair = make_pair(lambda u, v: SHIFT_PX, SIZE_PX[::-1], seed=2)
    (tmp_path / "target").mkdir()
    tifffile.imwrite(tmp_path / "target" / "target_clear.tif", np.ascontiguousarray(flip(board)))
    for name, image in zip("ab", pair, strict=True):
        tifffile.imwrite(tmp_path / f"{name}.tif", np.ascontiguousarray(flip(image)))
    (tmp_path / "board.yaml").write_text(
        yaml.safe_dump(
            {"kind": "chessboard", "square_mm": 3.0, "disc_mm": 1.2, "discs": [list(at) for at in CHIRAL]}
        )
    )
    nominal = camera(0.0, 0.0)
    if not is_plain:
        nominal = nominal.mirrored()
    scene = yaml.safe_load(dump_scene(Scene(nominal, ())))
    if flip(np.arange(4).reshape(2, 2))[0, 0] == 2:  # rows reversed: a mirror from left to right, and half a turn
        rotation = np.array(scene["camera"].get("rotation", np.eye(3)), float)
        scene["camera"]["rotation"] = (np.diag((-1.0, -1.0, 1.0)) @ rotation).tolist()
    (tmp_path / "scene.yaml").write_text(yaml.safe_dump(scene))
    fit = ["calibrate", "target", "--scene", "scene.yaml", "--board", "board.yaml", "-o", "fit", "--no-pictures"]
    assert main(fit) == DONE
    told = ["--scene", "fit/scene.yaml", "--dt-us", str(DT_US), "--final-window", "32", "--workers", "1"]
    assert main(["evaluate", "a.tif", "b.tif", *told, "-o", "out", "--no-pictures"]) == DONE
    fields = read_vectors(tmp_path / "out" / "vectors.nc").fields
    u, v = (float(np.nanmedian(fields[name])) for name in "uv")
    m_s_per_px = 1e-3 * MM / (1e-6 * DT_US)
    np.testing.assert_allclose((u, v), np.multiply(SHIFT_PX, m_s_per_px) * (1.0, -1.0), atol=0.05 * m_s_per_px)
