"""What a frame says of itself survives the camera, is never misread, and shows what is filed wrongly."""

import random

import numpy as np
import pytest

from sim.camera.packing import FORMATS, to_format_bits
from sim.frame_truth import WORLDS, FrameTruth, NoTruth, truth_of, with_truth
from tests.loops import loop_over

AXES = ["rail_z", "glass_x", "target_y"]
TRUTH = FrameTruth(7, 4_000_000_001, {"rail_z": -194.9995, "glass_x": 0.0, "target_y": 1700.123}, True)


def picture(seed=0, bits=12, shape=(60, 70)):
    return np.random.default_rng(seed).integers(0, 1 << bits, shape).astype(np.uint16)


def expected(truth):
    return FrameTruth(
        truth.trigger,
        truth.exposure,
        {axis: round(at_mm, 3) for axis, at_mm in truth.true_mm.items()},
        truth.is_moving,
        truth.world,
    )


@loop_over("name", FORMATS)
def test_it_goes_through_every_format(name):
    image = to_format_bits(with_truth(picture(), TRUTH, 12), 12, name)
    read = truth_of(image, AXES)
    assert (read.trigger, read.exposure, read.is_moving) == (7, 4_000_000_001, True)
    assert read.true_mm == pytest.approx(TRUTH.true_mm, abs=0.0006)


def test_it_goes_through_gain_offset_and_a_crop_of_the_other_sides():
    image = with_truth(picture(), TRUTH, 12)
    for changed in (np.minimum(image * 3.7, 4095), image // 2 + 300, image * 0.1 + 17, image[:20, :40]):
        assert truth_of(changed.astype(np.uint16), AXES).true_mm == pytest.approx(TRUTH.true_mm, abs=0.0006)


def test_the_rest_of_the_picture_is_what_it_was():
    before = picture()
    after = with_truth(before, TRUTH, 12)
    assert np.array_equal(after[8:], before[8:])
    assert np.array_equal(after[:, 32:], before[:, 32:])


def test_a_damaged_block_is_never_read_as_another_one():
    rng = random.Random(2)
    image = with_truth(picture(), TRUTH, 12)
    right = truth_of(image, AXES)
    refused = 0
    for _ in range(500):
        damaged = image.copy()
        for _ in range(rng.randint(1, 6)):
            damaged[rng.randrange(8), rng.randrange(32)] = rng.choice((0, 4095))
        try:
            assert truth_of(damaged, AXES) == right
        except NoTruth:
            refused += 1
    assert refused > 250


@pytest.mark.parametrize(
    "image",
    [
        picture(),
        np.zeros((60, 70), np.uint16),
        np.full((60, 70), 4095, np.uint16),
        picture(shape=(4, 70)),
        with_truth(picture(), TRUTH, 12)[:, 1:],
        with_truth(picture(), TRUTH, 12)[1:],
    ],
)
def test_a_frame_without_truth_tells_none(image):
    with pytest.raises(NoTruth):
        truth_of(image, AXES)


def test_the_truth_of_another_bench_is_refused():
    with pytest.raises(NoTruth, match="3 axes, not of 2"):
        truth_of(with_truth(picture(), TRUTH, 12), AXES[:2])


def test_every_draw_comes_back():
    rng = random.Random(1)
    for _ in range(200):
        places_mm = {f"a{index}": rng.uniform(-2000, 2000) for index in range(rng.randint(1, 12))}
        numbers = rng.getrandbits(32), rng.getrandbits(32)
        truth = FrameTruth(*numbers, places_mm, rng.random() < 0.5, rng.randrange(WORLDS))
        read = truth_of(with_truth(picture(rng.randrange(9), 10), truth, 10), list(places_mm))
        assert read == expected(truth)
