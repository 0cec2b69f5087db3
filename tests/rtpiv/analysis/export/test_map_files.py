"""Maps of a scene for other programs: their resampling with our map is our correction."""

import cv2
import numpy as np
import pytest
import tifffile
from scipy.io import netcdf_file

from correction.maps.correction_map import build_correction_map
from correction.maps.corrector import Corrector
from rtpiv.command_line.cli import DONE, USAGE, main
from tests.rtpiv.test_cli import SMALL
from tracer.scene.scene_file import load_scene
from tracer.strategies.ray_map import build_ray_map


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    place = tmp_path_factory.mktemp("lab")
    (place / "lab.yaml").write_text(SMALL)
    for to in ("netcdf", "tiff"):
        assert main(["export", str(place / "lab.yaml"), "--to", to, "-o", str(place / "out")]) == DONE
    return place


def test_opencv_corrects_by_the_images(lab):
    scene = load_scene(lab / "lab.yaml")
    found = build_correction_map(scene, build_ray_map(scene))
    u, v, mask = (tifffile.imread(lab / "out" / f"lab_{name}.tif") for name in ("u", "v", "mask"))
    rows, columns = np.indices(scene.camera.shape)
    frame = (1000.0 + 3.0 * columns + 7.0 * rows).astype(np.float32)  # linear: any interpolation is exact
    theirs = cv2.remap(frame, u, v, cv2.INTER_LINEAR)
    ours = Corrector(found, method="bilinear")(frame)
    assert np.array_equal(mask == 255, found.recovered)
    shown = cv2.erode(mask, np.ones((5, 5), np.uint8)) == 255  # ours averages over footprints: not at edges
    assert shown.sum() > 500
    np.testing.assert_allclose(theirs[shown], ours[shown], atol=0.6)  # remap has steps of 1/32 px


def test_netcdf_has_the_numbers_with_y_upwards(lab):
    scene = load_scene(lab / "lab.yaml")
    rays = build_ray_map(scene)
    found = build_correction_map(scene, rays)
    with netcdf_file(lab / "out" / "lab_correction.nc", mmap=False) as file:
        y, x = file.variables["y"][:], file.variables["x"][:]
        u, status = file.variables["pixel_u"], file.variables["status"]
        assert u.dimensions == ("y", "x")
        assert u.units == b"px"
        assert (np.diff(y) > 0.0).all()
        assert np.nanmax(file.variables["transmittance"][:]) <= 1.0 + 1e-5
        nodes = found.grid.nodes_mm()
        np.testing.assert_allclose(np.stack(np.meshgrid(x, y[::-1]), axis=-1), nodes, atol=1e-12)
        np.testing.assert_array_equal(u[:][::-1], found.pixel[0, ..., 0])
        np.testing.assert_array_equal(status[:][::-1], found.status)
        assert status.flag_meanings.startswith(b"0 recovered, 1 hidden by the rim")
        assert b"0 direct" in file.variables["branch"].flag_meanings
        assert file.scene_hash == scene.content_hash().encode()
    with netcdf_file(lab / "out" / "lab_rays.nc", mmap=False) as file:
        np.testing.assert_array_equal(file.variables["plane_x"][:], rays.plane_mm[..., 0])
        np.testing.assert_array_equal(file.variables["branch"][:], rays.branch)


@pytest.mark.parametrize("to", ["netcdf", "tiff"])
def test_what_was_written_is_said(lab, to, tmp_path, capsys):
    assert main(["export", str(lab / "lab.yaml"), "--to", to, "-o", str(tmp_path / "o")]) == DONE
    said = " ".join(capsys.readouterr().out.split())
    assert "pixels [px] of nodes" in said
    assert "NaN where nothing is recovered" in said


@pytest.mark.parametrize(("file", "to"), [("lab.yaml", "matlab"), ("out/lab_rays.nc", "tiff")])
def test_the_other_kind_is_refused(lab, file, to, tmp_path, capsys):
    assert main(["export", str(lab / file), "--to", to, "-o", str(tmp_path / "o")]) == USAGE
    assert "can be exported to" in capsys.readouterr().err
    assert not (tmp_path / "o").exists()
