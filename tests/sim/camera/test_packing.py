"""Camera bytes against bit strings written out by hand."""

import numpy as np

from sim.camera.packing import FORMATS, pack, payload_bytes, to_format_bits
from tests.loops import loop_over


def bits_by_definition(name, pixels):
    """Bytes of a row of pixels, from the text of the standards, with Python integers only."""
    if name in ("Mono10p", "Mono12p", "Mono14p"):
        bits = int(name[4:6])
        stream = sum(value << (bits * index) for index, value in enumerate(pixels))
        return stream.to_bytes(-(-len(pixels) * bits // 8), "little")
    if name == "Mono10Packed":
        pixels, count = [*pixels, 0] if len(pixels) % 2 else pixels, len(pixels)
        groups = [[a // 4, b % 4 * 16 + a % 4, b // 4] for a, b in zip(pixels[0::2], pixels[1::2], strict=True)]
        return bytes(byte for group in groups for byte in group)[: -(-count * 12 // 8)]
    if name == "Mono12Packed":
        out = bytearray()
        for first, second in zip(
            pixels[0::2], [*pixels[1::2], 0] if len(pixels) % 2 else pixels[1::2], strict=True
        ):
            out += bytes([first >> 4, (second & 15) << 4 | first & 15, second >> 4])
        return bytes(out[: -(-len(pixels) * 12 // 8)])
    return b"".join(value.to_bytes(1 if name == "Mono8" else 2, "little") for value in pixels)


@loop_over("name", FORMATS)
@loop_over("shape", [(1, 1), (1, 2), (3, 5), (4, 6), (5, 1)])
def test_bytes_are_those_of_the_standard(name, shape):
    top = 1 << FORMATS[name][2]
    image = np.random.default_rng(3).integers(0, top, shape, dtype=np.uint16)
    packed = pack(image, name)
    assert packed.tobytes() == bits_by_definition(name, [int(v) for v in image.ravel()])
    assert packed.size == payload_bytes(name, shape[1], shape[0])


def test_known_bytes():
    assert pack(np.array([[0x123, 0xABC]], np.uint16), "Mono12p").tobytes().hex() == "23c1ab"
    assert pack(np.array([[0x123, 0xABC]], np.uint16), "Mono12Packed").tobytes().hex() == "12c3ab"
    # Pixels 0x155 and 0x2AA: bits 01 0101 0101 and 10 1010 1010.
    assert pack(np.array([[0x155, 0x2AA]], np.uint16), "Mono10p").tobytes().hex() == "55a90a"
    assert pack(np.array([[0x155, 0x2AA]], np.uint16), "Mono10Packed").tobytes().hex() == "5521aa"


def test_grey_values_move_to_the_top_of_wider_and_out_of_narrower_formats():
    image = np.array([[0xFFF, 0x010]], np.uint16)
    assert to_format_bits(image, 12, "Mono16").tolist() == [[0xFFF0, 0x100]]
    assert to_format_bits(image, 12, "Mono8").tolist() == [[0xFF, 0x01]]
    assert to_format_bits(image, 12, "Mono12").tolist() == image.tolist()
