"""Unpacking against bits picked one at a time from Python integers, compiled and interpreted."""

import numpy as np
import pytest

from daq.cameras.formats import BY_CODE, FORMATS, pixel_format
from daq.cameras.kernels import unpack as kernels
from daq.cameras.pixels import unpack, warm_up
from daq.errors import BadFrame
from tests.loops import loop_over

WIDTHS = [1, 2, 3, 7, 8, 31]


def pixel_by_definition(name, data, width, row, col, row_bytes):
    """One pixel by the words of the standard; `row_bytes` None means that rows follow without a gap."""
    base, index = (0, row * width + col) if row_bytes is None else (row * row_bytes, col)
    if name.endswith("p"):
        bits = int(name[4:-1])
        return int.from_bytes(data[base:], "little") // 2 ** (bits * index) % 2**bits
    if name.endswith("Packed"):
        below = {"Mono10Packed": 4, "Mono12Packed": 16}[name]  # values of the bits that stand in the middle byte
        group = data[base + 3 * (index // 2) : base + 3 * (index // 2) + 3].ljust(3, b"\0")
        high, nibble = (group[0], group[1] & 15) if index % 2 == 0 else (group[2], group[1] >> 4)
        return high * below + nibble % below
    per_pixel = 1 if name == "Mono8" else 2
    start = row * (row_bytes or width * per_pixel) + col * per_pixel
    value = int.from_bytes(data[start : start + per_pixel], "little")
    return value % {"Mono8": 256, "Mono10": 1024, "Mono12": 4096, "Mono14": 16384, "Mono16": 65536}[name]


@loop_over("name", FORMATS)
@loop_over("width", WIDTHS)
@loop_over("padding", [None, 0, 3])
def test_every_bit_lands_where_the_standard_says(name, width, padding):
    form = FORMATS[name]
    height = 5
    row_bytes = None if padding is None else -(-width * form.wire_bits // 8) + padding
    size = -(-width * height * form.wire_bits // 8) if row_bytes is None else row_bytes * height
    data = np.frombuffer(np.random.default_rng(width).bytes(size), np.uint8)  # read-only, as payloads are
    if padding is None and size == -(-width * form.wire_bits // 8) * height:
        row_bytes = size // height  # both layouts are the same bytes
    out = np.zeros(width * height + 4, np.uint16)
    image = unpack(data, form, width, height, padding or 0, out)
    for row in range(height):
        for col in range(width):
            assert image[row, col] == pixel_by_definition(name, data.tobytes(), width, row, col, row_bytes)
    assert not out[width * height :].any()


def test_interpreted_kernels_equal_compiled_ones():
    data = np.frombuffer(np.random.default_rng(1).bytes(4096), np.uint8)
    cases = [
        (kernels.unpack_8, (9 * 8,)),
        (kernels.unpack_16, (9 * 16, 0x3FF)),
        (kernels.unpack_12p, (9 * 12,)),
        (kernels.unpack_stream, (9 * 14, 14)),
        (kernels.unpack_packed, (9 * 12, 10)),
        (kernels.unpack_packed, (9 * 12, 12)),
    ]
    for kernel, arguments in cases:
        compiled, interpreted = np.zeros((6, 9), np.uint16), np.zeros((6, 9), np.uint16)
        kernel(data, *arguments, compiled)
        kernel.py_func(data, *arguments, interpreted)
        np.testing.assert_array_equal(compiled, interpreted)


def test_published_example_of_mono12p():
    # Pixel values 0x123 and 0xABC as a little-endian bit stream: 23 C1 AB.
    image = unpack(np.array([0x23, 0xC1, 0xAB], np.uint8), FORMATS["Mono12p"], 2, 1, 0, np.zeros(2, np.uint16))
    assert image.tolist() == [[0x123, 0xABC]]
    # The same two pixels in GigE Vision order: high bytes outside, low nibbles in the middle.
    image = unpack(
        np.array([0x12, 0xC3, 0xAB], np.uint8), FORMATS["Mono12Packed"], 2, 1, 0, np.zeros(2, np.uint16)
    )
    assert image.tolist() == [[0x123, 0xABC]]


def test_every_monochrome_format_up_to_16_bits_of_the_standard_is_known():
    # PFNC 2.4 and GigE Vision 1.2 (the packed ones); signed and sub-byte formats are no camera's for measuring.
    codes = {"Mono8": 0x01080001, "Mono10": 0x01100003, "Mono10p": 0x010A0046, "Mono10Packed": 0x010C0004,
             "Mono12": 0x01100005, "Mono12p": 0x010C0047, "Mono12Packed": 0x010C0006, "Mono14": 0x01100025,
             "Mono14p": 0x010E0104, "Mono16": 0x01100007}  # fmt: skip
    assert {name: form.code for name, form in FORMATS.items()} == codes
    for form in FORMATS.values():
        assert form.wire_bits == form.code >> 16 & 0xFF  # the code says it


@pytest.mark.parametrize("name", ["Mono8", "Mono10", "Mono10p", "Mono10Packed", "Mono12", "Mono12p",
                                  "Mono12Packed", "Mono14", "Mono14p", "Mono16"])  # fmt: skip
def test_harvesters_own_unpacking_gives_the_same_pixels(name):
    pfnc = pytest.importorskip("harvesters.util.pfnc", reason="harvesters is not installed (extra rtpiv[camera])")
    width, height, form = 56, 6, FORMATS[name]  # whole groups of 3, 5 and 7 bytes: others it refuses
    data = np.random.default_rng(5).integers(0, 256, width * height * form.wire_bits // 8, dtype=np.uint8)
    if form.wire_bits == 16:  # it passes bits on that the format does not have
        data[1::2] &= (1 << (form.significant_bits - 8)) - 1
    raw = data.view("<u2") if form.wire_bits == 16 else data
    expected = getattr(pfnc, name)().expand(raw).reshape(height, width)
    image = unpack(data, form, width, height, 0, np.zeros(width * height, np.uint16))
    if name == "Mono14p":  # it loses the top bits of the second and third of four pixels (1.4.3)
        image, expected = image[:, ::4], expected[:, ::4]
    np.testing.assert_array_equal(image, expected)


@pytest.mark.parametrize(
    ("width", "height", "padding", "size", "room"),
    [(8, 8, 0, 95, 64), (8, 8, 1, 100, 64), (8, 8, 0, 96, 63), (0, 8, 0, 96, 64), (8, -1, 0, 96, 64),
     (1 << 31, 1 << 31, 0, 96, 64), (8, 8, -4, 96, 64)],
)  # fmt: skip
def test_sizes_that_contradict_the_data_are_refused(width, height, padding, size, room):
    with pytest.raises(BadFrame):
        unpack(np.zeros(size, np.uint8), FORMATS["Mono12p"], width, height, padding, np.zeros(room, np.uint16))


def test_unknown_format_names_the_cure():
    with pytest.raises(BadFrame, match="Mono12p"):
        pixel_format("BayerRG8")
    with pytest.raises(BadFrame, match="0x1080009"):
        pixel_format(0x01080009)
    assert BY_CODE[0x010C0047].name == "Mono12p"


@loop_over("is_read_only", [True, False])
def test_a_frame_finds_its_kernel_compiled(is_read_only):
    """A payload of a GenTL producer is bytes, that of Aravis an array: numba compiles for either."""

    def compiled():
        found = [getattr(kernels, name) for name in dir(kernels) if name.startswith("unpack_")]
        return [len(kernel.signatures) for kernel in found]

    warm_up(is_read_only)
    before = compiled()
    payload = bytes(2 * 33 * 21) if is_read_only else bytearray(2 * 33 * 21)
    for form in FORMATS.values():
        raw = np.frombuffer(payload, np.uint8)[: -(-33 * 21 * form.wire_bits // 8)]
        unpack(raw, form, 33, 21, 0, np.zeros(33 * 21, np.uint16))
    assert compiled() == before
    assert all(before)
