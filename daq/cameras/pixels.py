"""Camera bytes to grey values.

Sizes come from the wire and are never trusted: a frame is unpacked only after its bytes were counted.
"""

import numpy as np
from numpy.typing import NDArray

from daq.cameras.formats import FORMATS, PixelFormat
from daq.cameras.kernels.unpack import unpack_8, unpack_12p, unpack_16, unpack_packed, unpack_stream
from daq.errors import BadFrame

MAX_SIDE_PX = 1 << 16


def warm_up(is_read_only: bool = False) -> None:
    """Compile or load all kernels now, so that the first frame of a run is not late.

    Parameters
    ----------
    is_read_only : bool
        Whether payloads will be read-only, as those of a GenTL producer are: kernels are compiled for either.
    """
    raw = np.zeros(8, np.uint8)
    raw.flags.writeable = not is_read_only
    for form in FORMATS.values():
        unpack(raw, form, 2, 1, 0, np.zeros(2, np.uint16))


def row_pitch_bits(form: PixelFormat, width: int, height: int, padding_bytes: int, size_bytes: int) -> int:
    """Distance between the starts of two rows [bit].

    A declared padding means that rows start at bytes.  Without one, a row that ends inside a byte may still be
    rounded up to whole bytes by the camera; only the size of the payload tells, so an exact match decides.
    """
    row_bytes = -(-width * form.wire_bits // 8)
    if padding_bytes or size_bytes == row_bytes * height:
        return 8 * (row_bytes + padding_bytes)
    return width * form.wire_bits


def unpack(
    raw: NDArray[np.uint8], form: PixelFormat, width: int, height: int, padding_bytes: int, out: NDArray[np.uint16]
) -> NDArray[np.uint16]:
    """Write the grey values of one payload into `out`.

    Parameters
    ----------
    raw : (N,) uint8
        Payload as delivered, without trailing chunk data.
    form : PixelFormat
        Format on the wire.
    width, height : int
        Size of the image [px].
    padding_bytes : int
        Bytes after each row that belong to no pixel.
    out : (M,) uint16, contiguous
        Memory for at least ``width * height`` values.

    Returns
    -------
    (height, width) uint16
        View of `out`.

    Raises
    ------
    BadFrame
        If the payload or `out` is too small for the announced size.
    """
    if not (0 < width <= MAX_SIDE_PX and 0 < height <= MAX_SIDE_PX and 0 <= padding_bytes <= MAX_SIDE_PX):
        raise BadFrame(f"a frame of {width} x {height} px with {padding_bytes} bytes of padding is refused")
    pitch = row_pitch_bits(form, width, height, padding_bytes, raw.size)
    needed_bytes = -(-((height - 1) * pitch + width * form.wire_bits) // 8)
    if raw.size < needed_bytes or out.size < width * height:
        raise BadFrame(
            f"a {form.name} frame of {width} x {height} px needs {needed_bytes} bytes and came with {raw.size} "
            f"(room for {out.size} px); check PayloadSize and the pixel format"
        )
    image = out.reshape(-1)[: width * height].reshape(height, width)
    bits = form.significant_bits
    if form.wire_bits == 8:
        unpack_8(raw, pitch, image)
    elif form.wire_bits == 16:
        unpack_16(raw, pitch, (1 << bits) - 1, image)
    elif form.is_grouped:
        unpack_packed(raw, pitch, bits, image)
    elif bits == 12:
        unpack_12p(raw, pitch, image)
    else:
        unpack_stream(raw, pitch, bits, image)
    return image
