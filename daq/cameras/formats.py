"""The pixel formats that frames may have: SFNC names, PFNC codes, bits.

Apart from unpacking, because a process that only passes frames on need not load compiled kernels.
Source: EMVA, GenICam Pixel Format Naming Convention 2.4, and its list of values.
"""

from dataclasses import dataclass

from daq.errors import BadFrame


@dataclass(frozen=True, slots=True)
class PixelFormat:
    """One format: SFNC name, PFNC code, bits a pixel takes on the wire, bits it can use.

    `is_grouped` says that two pixels share three bytes in the order of GigE Vision 1.x; other pixels of less than
    16 bits follow each other as a stream of bits.
    """

    name: str
    code: int
    wire_bits: int
    significant_bits: int
    is_grouped: bool = False


FORMATS = {
    entry.name: entry
    for entry in (
        PixelFormat("Mono8", 0x01080001, 8, 8),
        PixelFormat("Mono10", 0x01100003, 16, 10),
        PixelFormat("Mono10p", 0x010A0046, 10, 10),
        PixelFormat("Mono10Packed", 0x010C0004, 12, 10, is_grouped=True),
        PixelFormat("Mono12", 0x01100005, 16, 12),
        PixelFormat("Mono12p", 0x010C0047, 12, 12),
        PixelFormat("Mono12Packed", 0x010C0006, 12, 12, is_grouped=True),
        PixelFormat("Mono14", 0x01100025, 16, 14),
        PixelFormat("Mono14p", 0x010E0104, 14, 14),
        PixelFormat("Mono16", 0x01100007, 16, 16),
    )
}
BY_CODE = {entry.code: entry for entry in FORMATS.values()}


def pixel_format(name_or_code: str | int) -> PixelFormat:
    """Look a format up by SFNC name or PFNC code.

    Raises
    ------
    BadFrame
        If this format cannot be unpacked; set PixelFormat to one of `FORMATS`.
    """
    found = FORMATS.get(name_or_code) if isinstance(name_or_code, str) else BY_CODE.get(name_or_code)
    if found is None:
        shown = name_or_code if isinstance(name_or_code, str) else hex(name_or_code)
        raise BadFrame(f"pixel format {shown} cannot be unpacked; set PixelFormat to one of {', '.join(FORMATS)}")
    return found
