"""At which grey level a pixel is saturated: what the camera said of its bits, else what the frame itself tells."""

import numpy as np
import pytest
import tifffile

from daq.runs.acquired import full_scale
from daq.runs.journal import Journal
from daq.runs.run_folder import RunFolder
from tests.daq.small_run import about_run, keep_frame, planned


@pytest.mark.parametrize(("bits", "white"), [(8, 255.0), (10, 1023.0), (12, 4095.0), (16, 65535.0)])
def test_a_frame_of_a_run_has_the_scale_of_its_camera(tmp_path, bits, white):
    folder = RunFolder.create(tmp_path, "small", about_run([planned(0)]))
    journal = Journal(folder.journal_path)
    pixels = np.full((4, 6), 200, np.uint16)
    keep_frame(folder, journal, 0, pixels, bits=bits)
    journal.close()
    assert full_scale(folder.frame_path(0), pixels) == white
    assert full_scale(folder.frame_path(0), pixels - np.float32(7.5)) == white  # its background is off


@pytest.mark.parametrize(
    ("kind", "brightest", "white"),
    [(np.uint8, 40, 255.0), (np.uint16, 40, 4095.0), (np.uint16, 4096, 65535.0), (np.float32, 65535, 65535.0)],
)
def test_a_frame_of_others_tells_it_by_its_numbers(tmp_path, kind, brightest, white):
    pixels = np.array([[0, brightest]], kind)
    tifffile.imwrite(tmp_path / "a.tif", pixels)
    assert full_scale(tmp_path / "a.tif", pixels) == white
