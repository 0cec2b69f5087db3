"""One page of a TIFF as one grey image, whatever way it is stored: read right, or refused by its name.

    compression     none, deflate, PackBits, LZW (by OpenCV, which brings its codec)
    photometric     MinIsBlack; MinIsWhite is inverted; RGB and a palette, as grey
    orientation     rows and columns are turned as the tag says
    pages           one, or the one that is asked for

The directory is read before any pixel: a size that the file cannot hold, that is no camera's or that does not fit
into memory is refused there.  Deflate packs at most 1032 bytes into one, LZW fewer; a file that promises more
pixels than that does not have them.
"""

import os
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray
from tifffile import COMPRESSION, PHOTOMETRIC

from ground.memory import MOST_PX, require_memory
from piv.errors import FrameError
from piv.files.colours import grey_of
from piv.files.numbers import NEEDED, as_grey_levels

MOST_PACKED = 1100  # bytes of pixels in a byte of the file
GREY_BITS: dict[tuple[int, int], type[np.number[Any]]] = {  # by sample format
    (1, 8): np.uint8, (1, 16): np.uint16, (1, 32): np.uint32, (1, 64): np.uint64, (3, 32): np.float32,
    (2, 8): np.int8, (2, 16): np.int16, (2, 32): np.int32, (2, 64): np.int64, (3, 64): np.float64,
}  # fmt: skip
READ_AS: dict[int, tuple[int, type[np.number[Any]]]] = {  # sample format and kind that OpenCV reads, by bits
    8: (1, np.uint8), 16: (1, np.uint16), 32: (3, np.float32), 64: (3, np.float64),
}  # fmt: skip
PLAIN = (COMPRESSION.NONE, COMPRESSION.ADOBE_DEFLATE, COMPRESSION.DEFLATE, COMPRESSION.PACKBITS)
ALL_SEEN = {1, 2, 3, 4, 5, 6, 7, 8}  # orientations

Pixels = NDArray[Any]


def check_size(width: int, height: int, bytes_per_px: float, room_bytes: float) -> None:
    """Refuse a size before anything of it is decoded.

    Parameters
    ----------
    width, height : int
        Pixels, as the header says.
    bytes_per_px : float
        Of all channels.
    room_bytes : float
        Most that the file can unpack to.

    Raises
    ------
    FrameError
        Why, as the rest of a sentence.
    MemoryShort
        It does not fit into memory.
    """
    if not (width > 0 and height > 0):
        raise FrameError(f"is {width} x {height} px")
    if width * height > MOST_PX:
        raise FrameError(f"is {width} x {height} px; frames of up to {MOST_PX / 1e6:.0f} million pixels are read")
    if width * height * bytes_per_px > room_bytes:
        raise FrameError(f"says {width} x {height} px, more than it can hold; it is damaged")
    require_memory(3.0 * width * height * bytes_per_px, f"a frame of {width} x {height} px")


def size_in_file(page: Any) -> tuple[int, int]:  # noqa: ANN401 - tifffile has no types
    """Rows and columns of a page as it is seen, from its tags alone."""
    rows, columns = int(page.imagelength), int(page.imagewidth)
    return (columns, rows) if _orientation(page) > 4 else (rows, columns)


def grey_page(page: Any, stream: BinaryIO, number: int) -> Pixels:  # noqa: ANN401
    """Decode a page.

    Parameters
    ----------
    page : tifffile.TiffPage
        The page.
    stream : binary file
        The whole file.
    number : int
        Which page that is, 0 first.

    Raises
    ------
    FrameError
        Why it is no grey image, as the rest of a sentence.
    """
    photometric, samples = page.photometric, int(page.samplesperpixel)
    bits, form = page.bitspersample, int(page.sampleformat or 1)
    if _orientation(page) not in ALL_SEEN:
        raise FrameError(f"has an orientation {_orientation(page)} that does not exist")
    kinds = {PHOTOMETRIC.MINISBLACK: 1, PHOTOMETRIC.MINISWHITE: 1, PHOTOMETRIC.PALETTE: 1, PHOTOMETRIC.RGB: 3}
    if photometric not in kinds:
        raise FrameError(f"is stored as {_name(photometric)}; one grey image is needed, so export it as such")
    if samples != kinds[photometric] and not (photometric == PHOTOMETRIC.RGB and samples == 4):
        raise FrameError(f"has {samples} channels; one grey image is needed, so export it as such")
    if (form, bits) not in GREY_BITS:
        kind = {1: "uint", 2: "int", 3: "float"}.get(form, "other ")
        raise FrameError(f"holds {kind}{bits}; {NEEDED}")
    if _needs_opencv(page) and form != READ_AS[bits][0] and 339 not in page.tags:
        raise FrameError(f"holds {GREY_BITS[form, bits].__name__} compressed by {_name(page.compression)}; save it"
                         " uncompressed")  # fmt: skip
    if int(page.imagedepth) != 1:
        raise FrameError("is a volume; one grey image is needed")
    packed = 1 if page.compression == COMPRESSION.NONE else MOST_PACKED
    room_bytes = packed * os.fstat(stream.fileno()).st_size
    check_size(int(page.imagewidth), int(page.imagelength), samples * bits / 8, room_bytes)
    pixels = _by_opencv(page, stream, number) if _needs_opencv(page) else np.asarray(page.asarray())
    if page.planarconfig == 2 and pixels.ndim == 3:
        pixels = np.moveaxis(pixels, 0, -1)
    expected = (int(page.imagelength), int(page.imagewidth))
    if pixels.shape[:2] != expected or pixels.dtype != GREY_BITS[form, bits]:
        raise FrameError("is damaged: its pixels are not what its tags say")
    if photometric == PHOTOMETRIC.PALETTE:
        pixels = _from_palette(pixels, page.colormap)
    elif photometric == PHOTOMETRIC.MINISWHITE:
        if form != 1:
            raise FrameError(
                f"is MinIsWhite in {GREY_BITS[form, bits].__name__}, where no number is white; export it as"
                " MinIsBlack"
            )
        pixels = np.bitwise_not(pixels)
    elif photometric == PHOTOMETRIC.RGB:
        pixels = grey_of(pixels)
    return np.ascontiguousarray(_turn(as_grey_levels(pixels), _orientation(page)))


def _needs_opencv(page: Any) -> bool:  # noqa: ANN401
    """Return whether tifffile lacks the codec, and OpenCV has it; FrameError if both lack it."""
    if page.compression in PLAIN and page.predictor in (1, 2):
        return False
    if page.compression in PLAIN or page.compression == COMPRESSION.LZW:
        return True
    raise FrameError(
        f"is compressed by {_name(page.compression)}, which nothing here reads; save it uncompressed, or by LZW"
        " or deflate"
    )


def _by_opencv(page: Any, stream: BinaryIO, number: int) -> Pixels:  # noqa: ANN401
    """Decode by OpenCV's codecs, which invert and turn some images themselves: the tags that say so are hidden.

    Of the kinds of number it knows one of each size; others are unpacked as that one, bit by bit.
    """
    import cv2

    stream.seek(0)
    altered = bytearray(stream.read())
    order = "little" if page.parent.byteorder == "<" else "big"
    form, kind = READ_AS[page.bitspersample]
    own = GREY_BITS[int(page.sampleformat or 1), page.bitspersample]
    for code, plain in ((262, 2 if page.samplesperpixel > 1 else 1), (274, 1), (339, form)):
        tag = page.tags.get(code)
        if tag is not None and tag.count == 1:
            altered[tag.valueoffset : tag.valueoffset + 2] = plain.to_bytes(2, order)  # type: ignore[arg-type]
    try:
        pages = (number, number + 1)
        whole, found = cv2.imdecodemulti(np.frombuffer(altered, np.uint8), cv2.IMREAD_UNCHANGED, range=pages)
    except cv2.error:
        whole, found = False, ()
    if not whole or len(found) != 1:
        raise FrameError(f"is compressed by {_name(page.compression)}, and damaged; copy it from the camera again")
    pixels = np.asarray(found[0])
    if pixels.dtype == kind:
        pixels = pixels.view(own)
    return pixels if pixels.ndim == 2 else pixels[..., [2, 1, 0, 3][: pixels.shape[2]]]  # OpenCV has blue first


def _from_palette(pixels: Pixels, palette: Any) -> Pixels:  # noqa: ANN401
    """Grey behind each number; a palette of 257 x n is one of 8 bits, as nearly all are."""
    if palette is None or np.ndim(palette) != 2 or len(palette) != 3:
        raise FrameError("has a palette that is damaged")
    colours = np.asarray(palette).T
    if int(pixels.max(initial=0)) >= len(colours):
        raise FrameError("has a palette that is damaged")
    colours = (colours // 257).astype(np.uint8) if not (colours % 257).any() else colours.astype(np.uint16)
    return np.asarray(grey_of(colours[None])[0][pixels])


def _turn(pixels: Pixels, orientation: int) -> Pixels:
    """Rows from the top, columns from the left: the tag says where the first row and column are seen."""
    if orientation > 4:
        pixels = pixels.T
    pixels = pixels[::-1] if orientation in (3, 4, 7, 8) else pixels
    return pixels[:, ::-1] if orientation in (2, 3, 6, 7) else pixels


def _orientation(page: Any) -> int:  # noqa: ANN401
    tag = page.tags.get(274)
    return 1 if tag is None else int(tag.value)


def _name(value: Any) -> str:  # noqa: ANN401
    return str(getattr(value, "name", value))
