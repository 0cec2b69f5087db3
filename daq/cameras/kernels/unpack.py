"""Camera bytes to uint16 grey values.

Rows may be padded, or packed without a gap so that a row starts inside a byte.  Both are said by one number,
the pitch of a row in bits: ``width * bits`` when rows follow each other without a gap, a multiple of 8 when every
row starts at a byte.

Formats of the GenICam Pixel Format Naming Convention (PFNC 2.x) and of GigE Vision 1.x:

* Mono8, Mono10, Mono12, Mono14, Mono16: one or two bytes a pixel, little-endian.
* Mono10p, Mono14p: a little-endian bit stream, the lowest bit of a pixel first; four pixels in 5 or 7 bytes.
* Mono12p: the same; pixel 0 is byte 0 and the low nibble of byte 1, pixel 1 is the high nibble of byte 1 and
  byte 2. The usual format has a loop of its own, which is faster.
* Mono12Packed: three bytes for two pixels as well, in GigE Vision order: byte 0 holds bits 11..4 of pixel 0,
  byte 1 the low nibbles (pixel 0 low, pixel 1 high), byte 2 bits 11..4 of pixel 1.
* Mono10Packed: the same with bits 9..2 outside and two low bits at the foot of each nibble; the rest is unused.

``int(...)`` keeps the interpreted kernels from overflowing a uint8; it costs nothing when compiled.
"""

from ground.jit import Array, kernel


@kernel
def unpack_8(raw: Array, row_bits: int, out: Array) -> None:
    """Mono8: raw (N,) uint8, out (H, W) uint16."""
    for row in range(out.shape[0]):
        start = (row * row_bits) >> 3
        for col in range(out.shape[1]):
            out[row, col] = raw[start + col]


@kernel
def unpack_16(raw: Array, row_bits: int, mask: int, out: Array) -> None:
    """Mono10 to Mono16: raw (N,) uint8, out (H, W) uint16; bits outside `mask` are dropped."""
    for row in range(out.shape[0]):
        start = (row * row_bits) >> 3
        for col in range(out.shape[1]):
            at = start + 2 * col
            out[row, col] = (int(raw[at]) | (int(raw[at + 1]) << 8)) & mask


@kernel
def unpack_12p(raw: Array, row_bits: int, out: Array) -> None:
    """Mono12p: raw (N,) uint8, out (H, W) uint16."""
    width = out.shape[1]
    for row in range(out.shape[0]):
        bit = row * row_bits
        at = bit >> 3
        col = 0
        if bit & 4 and width > 0:  # the row starts in the high nibble
            out[row, 0] = (int(raw[at]) >> 4) | (int(raw[at + 1]) << 4)
            at += 2
            col = 1
        while col + 1 < width:
            middle = int(raw[at + 1])
            out[row, col] = int(raw[at]) | ((middle & 15) << 8)
            out[row, col + 1] = (middle >> 4) | (int(raw[at + 2]) << 4)
            at += 3
            col += 2
        if col < width:
            out[row, col] = int(raw[at]) | ((int(raw[at + 1]) & 15) << 8)


@kernel
def unpack_stream(raw: Array, row_bits: int, bits: int, out: Array) -> None:
    """Pixels of 9 to 16 `bits` as a little-endian bit stream: raw (N,) uint8, out (H, W) uint16."""
    mask = (1 << bits) - 1
    for row in range(out.shape[0]):
        first = row * row_bits
        for col in range(out.shape[1]):
            bit = first + col * bits
            at, shift = bit >> 3, bit & 7
            value = int(raw[at]) | (int(raw[at + 1]) << 8)
            if shift + bits > 16:
                value |= int(raw[at + 2]) << 16
            out[row, col] = (value >> shift) & mask


@kernel
def unpack_packed(raw: Array, row_bits: int, bits: int, out: Array) -> None:
    """Mono10Packed, Mono12Packed: raw (N,) uint8, out (H, W) uint16."""
    width, low = out.shape[1], bits - 8
    mask = (1 << low) - 1
    for row in range(out.shape[0]):
        bit = row * row_bits
        at = bit >> 3
        col = 0
        if bit & 4 and width > 0:  # second pixel of a group of three bytes
            out[row, 0] = (int(raw[at + 1]) << low) | ((int(raw[at]) >> 4) & mask)
            at += 2
            col = 1
        while col + 1 < width:
            middle = int(raw[at + 1])
            out[row, col] = (int(raw[at]) << low) | (middle & mask)
            out[row, col + 1] = (int(raw[at + 2]) << low) | ((middle >> 4) & mask)
            at += 3
            col += 2
        if col < width:
            out[row, col] = (int(raw[at]) << low) | (int(raw[at + 1]) & mask)
