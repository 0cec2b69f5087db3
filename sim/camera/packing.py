"""Grey values to camera bytes, written from the format definitions with numpy only.

This is the simulator's own arithmetic: the receiving side unpacks with other code.  Pixels that are
no whole bytes are packed as one run over all rows, without rounding a row up to whole bytes.
"""

import numpy as np
from numpy.typing import NDArray

# name: (PFNC code, bits on the wire, significant bits)
FORMATS = {
    "Mono8": (0x01080001, 8, 8),
    "Mono10": (0x01100003, 16, 10),
    "Mono10Packed": (0x010C0004, 12, 10),
    "Mono10p": (0x010A0046, 10, 10),
    "Mono12": (0x01100005, 16, 12),
    "Mono12Packed": (0x010C0006, 12, 12),
    "Mono12p": (0x010C0047, 12, 12),
    "Mono14": (0x01100025, 16, 14),
    "Mono14p": (0x010E0104, 14, 14),
    "Mono16": (0x01100007, 16, 16),
}


def payload_bytes(name: str, width: int, height: int) -> int:
    """Size of a packed image [byte]."""
    return -(-width * height * FORMATS[name][1] // 8)


def to_format_bits(image: NDArray[np.uint16], sensor_bits: int, name: str) -> NDArray[np.uint16]:
    """Shift grey values from the sensor's bits to the format's bits."""
    shift = FORMATS[name][2] - sensor_bits
    return np.left_shift(image, np.uint16(shift)) if shift >= 0 else np.right_shift(image, np.uint16(-shift))


def pack(image: NDArray[np.uint16], name: str) -> NDArray[np.uint8]:
    """Bytes of one image.

    Parameters
    ----------
    image : (H, W) uint16
        Grey values within the format's bits.
    name : str
        One of `FORMATS`.

    Returns
    -------
    (N,) uint8
        Exactly `payload_bytes` bytes.
    """
    flat = np.ascontiguousarray(image).reshape(-1)
    if name == "Mono8":
        return flat.astype(np.uint8)
    if FORMATS[name][1] == 16:
        return flat.astype("<u2", copy=False).view(np.uint8)
    if name in ("Mono10p", "Mono14p"):
        bits = flat[:, None] >> np.arange(FORMATS[name][2], dtype=np.uint16) & np.uint16(1)
        return np.packbits(bits.astype(np.uint8).reshape(-1), bitorder="little")
    even, odd = flat[0::2], flat[1::2]
    if odd.size < even.size:
        odd = np.append(odd, np.uint16(0))
    packed = np.empty((even.size, 3), np.uint8)
    if name == "Mono12p":
        packed[:, 0] = even & 0xFF
        packed[:, 1] = (even >> 8) | ((odd & 0xF) << 4)
        packed[:, 2] = odd >> 4
    elif name == "Mono10Packed":
        packed[:, 0] = even >> 2
        packed[:, 1] = (even & 0x3) | ((odd & 0x3) << 4)
        packed[:, 2] = odd >> 2
    else:
        packed[:, 0] = even >> 4
        packed[:, 1] = (even & 0xF) | ((odd & 0xF) << 4)
        packed[:, 2] = odd >> 4
    return packed.reshape(-1)[: payload_bytes(name, image.shape[1], image.shape[0])]
