"""What binning, decimation, reversal and a region make of a scene's camera, judged by fractions of pixels."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from daq.bench.bench_file import load_bench
from daq.bench.read_out import image_of
from daq.errors import SettingRefused
from ground.errors import ConfigError
from tests.daq.small_bench import write_bench
from tracer.camera import Camera, Lens

TURN = ((0.8, -0.6, 0.0), (-0.6, -0.8, 0.0), (0.0, 0.0, -1.0))
SENSOR = Camera(4000.0, (51.25, 37.5), (120, 90), (3.0, -2.0, 500.0), TURN, Lens(k1=0.3, p1=0.02, p2=-0.03))


def sensor_place(pixel, axis, settings):
    """Middle of what one pixel of the image shows, on the sensor: the mean of the pixels it is made of."""
    name = ("Horizontal", "Vertical")[axis]
    binning, decimation = (settings.get(f"{kind}{name}", 1) for kind in ("Binning", "Decimation"))
    first = (pixel + settings.get(("OffsetX", "OffsetY")[axis], 0)) * decimation * binning
    places = [Fraction(first + k) for k in range(binning)]
    if settings.get(("ReverseX", "ReverseY")[axis]):
        places = [SENSOR.sensor_px[axis] - 1 - place for place in places]
    return sum(places) / len(places)


CASES = [
    {},
    {"OffsetX": 8, "OffsetY": 4, "Width": 64, "Height": 32},
    {"BinningHorizontal": 2, "BinningVertical": 2},
    {"DecimationHorizontal": 3, "DecimationVertical": 3, "OffsetX": 5, "Width": 20},
    {"ReverseX": True, "ReverseY": True},
    {"ReverseX": True, "ReverseY": True, "BinningHorizontal": 2, "BinningVertical": 2, "DecimationHorizontal": 2,
     "DecimationVertical": 2, "OffsetX": 3, "OffsetY": 2, "Width": 24, "Height": 18},
]  # fmt: skip


@pytest.mark.parametrize("settings", CASES)
def test_every_pixel_of_the_image_looks_where_its_part_of_the_sensor_does(settings):
    """A pixel's ray in the world: pinhole, and direction by the ideal pixel."""
    image = image_of(SENSOR, settings)
    width, height = image.sensor_px
    for u, v in ((0, 0), (width - 1, 0), (7, 11), (width - 1, height - 1)):
        on_sensor = [float(sensor_place(pixel, axis, settings)) for axis, pixel in enumerate((u, v))]
        np.testing.assert_allclose(ray(image, (u, v)), ray(SENSOR, on_sensor), atol=1e-12)


def ray(camera, pixel):
    x, y = (camera.ideal(pixel) - np.array(camera.principal_px)) / camera.focal_px
    way = camera.rotation_matrix.T @ np.array([x, y, 1.0])
    return way / np.linalg.norm(way)


@pytest.mark.parametrize(("settings", "words"), [
    ({"BinningHorizontal": 2}, "BinningHorizontal 2 and BinningVertical 1 make pixels that are not square"),
    ({"DecimationVertical": 2}, "not square"),
    ({"ReverseX": True}, "alone mirrors"),
    ({"Width": 121}, "121 x 90 px at 0, 0 is not within a sensor that gives 120 x 90 px"),
    ({"BinningHorizontal": 2, "BinningVertical": 2, "Width": 120}, "gives 60 x 45 px"),
    ({"OffsetX": 120}, "is not within"),
    ({"OffsetX": -1}, "OffsetX = -1 is not a number"),
    ({"Width": 10.5}, "Width = 10.5 is not a number"),
])  # fmt: skip
def test_what_no_scene_describes_is_refused(settings, words):
    with pytest.raises(SettingRefused, match=words):
        image_of(SENSOR, settings)


CAMERA = """camera:
  backend: files
  options: {{folder: in}}
  settings: {{TriggerMode: "On", TriggerSource: Software{settings}}}
"""
BINNED = ", BinningHorizontal: 2, BinningVertical: 2"


def bench(folder, settings, more=""):
    return load_bench(write_bench(folder, camera=CAMERA.format(settings=settings) + more))


def test_a_bench_is_told_which_of_the_two_its_scene_shows(tmp_path):
    plain = bench(tmp_path / "a", "").scene
    assert bench(tmp_path / "b", BINNED).scene == plain
    binned = bench(tmp_path / "c", BINNED, "  scene_shows: sensor\n").scene
    assert binned.camera.sensor_px == (48, 48)
    assert binned == replace(plain, camera=image_of(plain.camera, {"BinningHorizontal": 2, "BinningVertical": 2}))
    assert bench(tmp_path / "d", ", ReverseX: true").scene == plain  # a mirror stands before the camera


@pytest.mark.parametrize(("settings", "more", "words"), [
    (", BinningHorizontal: 2", "", r"bench.yaml:\d+: .*not square"),
    (", ReverseX: true", "  scene_shows: sensor\n", r"bench.yaml:\d+: .*alone mirrors"),
    (", Width: 200", "  scene_shows: sensor\n", r"bench.yaml:\d+: .*sensor that gives 96 x 96"),
])  # fmt: skip
def test_a_bench_that_no_scene_describes_is_refused_with_its_line(tmp_path, settings, more, words):
    with pytest.raises(ConfigError, match=words):
        bench(tmp_path, settings, more)
