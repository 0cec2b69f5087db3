"""Frames on disk: read what cameras write, write what evaluations read.

Reading accepts one grey image a file (TIFF, PNG, BMP) of 8 or 16 bits or float32.  Writing is a 16-bit or
float32 TIFF with the scale as resolution tags and everything a later reader needs as JSON in the image
description: px_per_mm, origin_mm, offset, the hash of the scene.  A file appears under its final name only
when it is complete and on the disk.
"""

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import tifffile
from numpy.typing import NDArray

from correction.errors import FrameError
from tracer.whole_file import whole_file

TIFF_ENDINGS = (".tif", ".tiff")
FRAME_ENDINGS = (*TIFF_ENDINGS, ".png", ".bmp")


def read_frame(path: Path | str, shape: tuple[int, int] | None = None) -> NDArray[Any]:
    """Read one frame.

    Parameters
    ----------
    path : path
        .tif, .tiff, .png or .bmp.
    shape : (int, int), optional
        Rows and columns that the frame must have.

    Returns
    -------
    ndarray (H, W) of uint8, uint16 or float32

    Raises
    ------
    FrameError
        Missing, damaged, colour, several pages, another size, another kind of number.
    """
    path = Path(path)
    if path.suffix.lower() not in FRAME_ENDINGS:
        raise FrameError(f"{path}: is no frame; frames end in {', '.join(FRAME_ENDINGS)}")
    frame = _read_tiff(path) if path.suffix.lower() in TIFF_ENDINGS else _read_other(path)
    if frame.ndim != 2:
        raise FrameError(f"{path}: has shape {frame.shape}; one grey image is needed, no colour, no stack")
    if frame.dtype not in (np.uint8, np.uint16, np.float32):
        raise FrameError(f"{path}: holds {frame.dtype}; uint8, uint16 or float32 is needed")
    if shape is not None and frame.shape != shape:
        raise FrameError(
            f"{path}: is {frame.shape[1]} x {frame.shape[0]} px, the scene's camera {shape[1]} x {shape[0]} px"
        )
    return frame


def _read_tiff(path: Path) -> NDArray[Any]:
    try:
        with tifffile.TiffFile(path) as file:
            if len(file.pages) != 1:
                raise FrameError(f"{path}: holds {len(file.pages)} pages; one frame a file is needed")
            return np.asarray(file.pages[0].asarray())
    except FrameError:
        raise
    except OSError as error:
        raise FrameError(f"{path}: cannot be read: {error.strerror or error}") from None
    except Exception as error:  # damaged files surface as any error of the decoders below tifffile
        raise FrameError(f"{path}: is damaged or no TIFF ({error}); copy it from the camera again") from None


def _read_other(path: Path) -> NDArray[Any]:
    if not path.is_file():
        raise FrameError(f"{path}: cannot be read: no such file")
    frame = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if frame is None:
        raise FrameError(f"{path}: is damaged or no image; copy it from the camera again")
    return np.asarray(frame)


def write_frame(path: Path | str, frame: NDArray[Any], px_per_mm: float, description: dict[str, Any]) -> None:
    """Write one frame as TIFF, atomically.

    Parameters
    ----------
    path : path
        Final name.
    frame : ndarray (H, W)
        uint8, uint16 or float32.
    px_per_mm : float
        Scale, written as resolution tags (px/cm).
    description : dict
        JSON-able; stored as the image description.
    """
    resolution = (px_per_mm * 10.0, px_per_mm * 10.0)
    with whole_file(Path(path), let_go=True) as stream:
        tifffile.imwrite(
            stream,
            frame,
            photometric="minisblack",
            resolution=resolution,
            resolutionunit="CENTIMETER",
            description=json.dumps({"px_per_mm": px_per_mm, **description}),
            metadata=None,
        )
