"""A page of a PDF as a printer sets it, by a program that is not ours, and what a person finds on the paper.

Everything is measured on the dots, from the lower left corner of the page: where the board's origin is, how long
the bars in the margin are.  Nobody asks the product where it has printed.
"""

from dataclasses import dataclass
from itertools import permutations

import cv2
import numpy as np
import pytest
import scipy

from sim.renderer.patterns import Image, Pose

DPI = 600
DOT_MM = 25.4 / DPI
LEAST, MOST = 0.08, 0.92  # reflectance of ink and paper
BAR_MM, BESIDE_MM = 6.0, 1.3  # of a bar from the edge of the page; of a line across its end marks from the bar
ROUND = 0.03  # of its area, that a disc may have more or less


@dataclass(frozen=True)
class Page:
    """Grey values (rows, columns), row 0 at the top: 0 ink, 255 paper."""

    grey: np.ndarray

    def mm(self, column, row):
        """Place on the page [mm] of a place among its dots, whose centres are whole numbers."""
        return np.array((column + 0.5, len(self.grey) - row - 0.5)) * DOT_MM

    def print_at(self, origin_mm):
        """The page as a target whose origin is there."""
        middle_mm = 0.5 * DOT_MM * np.array(self.grey.shape[::-1])
        values = (LEAST + (MOST - LEAST) / 255.0 * self.grey).astype(np.float32)
        return Image(values, DOT_MM, MOST, Pose((*(middle_mm - origin_mm).tolist(), 0.0)))

    def bars_mm(self):
        """Lengths of the bars below and on the left, from end mark to end mark."""
        beside = round((BAR_MM + BESIDE_MM) / DOT_MM)
        return tuple(_apart(255.0 - line) * DOT_MM for line in (self.grey[-beside], self.grey[:, beside]))

    def origin_mm(self, kind, board):
        """Where the page has the origin of its board (PrintedBoard)."""
        return {"chessboard": self._by_discs, "dots": self._by_large_dots, "charuco": self._by_codes}[kind](board)

    def _by_discs(self, board):
        """In the middle between the two bright discs."""
        bright = self._round(board.disc_mm, ink=False)
        assert len(bright) == 2
        return bright.mean(axis=0)

    def _by_large_dots(self, board):
        """The large dot that has another one to the right, and the third two dots above it."""
        large = self._round(board.large_dot_mm, ink=True)
        assert len(large) == 3
        steps = np.array(((0, 0), (1, 0), (0, 2))) * board.pitch_mm
        (first,) = (
            large[i]
            for i, j, k in permutations(range(3))
            if np.abs(large[[i, j, k]] - large[i] - steps).max() < DOT_MM
        )
        return first

    def _by_codes(self, board):
        """OpenCV's corners, counted from the lower left one of the board: the mean of what all say."""
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
        laid_out = cv2.aruco.CharucoBoard(tuple(board.squares), board.square_mm, board.marker_mm, dictionary)
        settings = cv2.aruco.DetectorParameters()
        settings.minMarkerPerimeterRate = 0.005  # of the page, which is wide
        detector = cv2.aruco.CharucoDetector(laid_out, detectorParams=settings)
        corners, numbers, _, _ = detector.detectBoard(self.grey)
        columns, rows = board.squares
        assert len(numbers) == (columns - 1) * (rows - 1)
        j, i = np.divmod(numbers.ravel(), columns - 1)  # OpenCV counts rows from the top
        from_origin = np.column_stack((i + 1, rows - 1 - j)) - board.origin_corner
        said = self.mm(*corners.reshape(-1, 2).T).T - from_origin * board.square_mm
        assert said.std(axis=0).max() < 0.1 * DOT_MM
        return said.mean(axis=0)

    def _round(self, wide_mm, ink):
        """Middles (N, 2) [mm] of spots of ink, or of paper in ink, of one size."""
        dark = (self.grey < 128) == ink
        _, _, about, middle = cv2.connectedComponentsWithStats(dark.astype(np.uint8), connectivity=4)
        area = about[:, cv2.CC_STAT_AREA] * DOT_MM**2
        chosen = np.abs(area / (0.25 * np.pi * wide_mm**2) - 1.0) < ROUND
        return np.array([self.mm(*place) for place in middle[chosen]]).reshape(-1, 2)


def set_in_dots(path):
    """Set the first page of a PDF in dots, counted from its lower left corner."""
    document = pytest.importorskip("pypdfium2").PdfDocument(path)
    page = document[0]
    # A raster of whole dots: what is less than one at the right and upper edges would stretch all the others.
    left, lower, right, upper = page.get_mediabox()
    whole = (np.floor(length * DPI / 72.0) * 72.0 / DPI - 1e-4 for length in (right - left, upper - lower))
    width, height = whole
    page.set_mediabox(left, lower, left + width, lower + height)
    page.close()
    grey = document[0].render(scale=DPI / 72.0, grayscale=True).to_numpy()
    return Page(np.array(grey).reshape(grey.shape[:2]))


def _apart(ink):
    """Dots from the first to the last mark on a line of dots."""
    marks, count = scipy.ndimage.label(ink > 0)
    first, last = (scipy.ndimage.center_of_mass(ink, marks, number)[0] for number in (1, count))
    return last - first
