"""Videos to read: written by PyAV, and a .cine written here from what its maker says of the format."""

import struct

import numpy as np

H, W = 48, 64


def moving(count=12, kind=np.uint8):
    """Frames that all differ, smooth enough for a codec."""
    rows, columns = np.mgrid[:H, :W]
    most = np.iinfo(kind).max
    shown = [0.5 + 0.4 * np.sin(rows / 3 + n) * np.cos(columns / 4 - 0.7 * n) for n in range(count)]
    return np.rint(most * np.array(shown)).astype(kind)


def write_video(path, frames, codec="ffv1", pixels="gray", times=None, **options):
    """A video of grey or coloured frames, at 100 a second; `times` says when each was taken, in hundredths."""
    import av

    with av.open(str(path), "w") as file:
        track = file.add_stream(codec, rate=100, options={name: str(value) for name, value in options.items()})
        track.height, track.width = frames.shape[1:3]
        track.pix_fmt = pixels
        form = "rgb24" if frames.ndim == 4 else "gray" if frames.dtype == np.uint8 else "gray16le"
        for number, pixels_of in enumerate(frames):
            frame = av.VideoFrame.from_ndarray(pixels_of, format=form)
            frame.pts = number if times is None else times[number]
            file.mux(track.encode(frame))
        file.mux(track.encode(None))
    return path


def write_cine(path, frames, bits, flipped=False):
    """Header, bitmap header, setup, offsets, frames with an annotation of 8 bytes; rows from the bottom."""
    height, width = frames.shape[1:]
    size = frames[0].nbytes
    header, bitmap, setup = 44, 40, 5692
    offsets = header + bitmap + setup
    first = offsets + 8 * len(frames)
    setup_block = bytearray(setup)
    setup_block[140:142] = b"ST"
    struct.pack_into("<H", setup_block, 142, setup)
    struct.pack_into("<I", setup_block, 760, flipped)  # shown the other way up
    struct.pack_into("<I", setup_block, 768, 1000)  # frames a second
    struct.pack_into("<I", setup_block, 896, bits)
    count = len(frames)
    with path.open("wb") as file:
        file.write(
            struct.pack(
                "<2sHHHiIiIIIIII", b"CI", header, 0, 1, 0, count, 0, count, header, header + bitmap, offsets, 0, 0
            )
        )
        file.write(struct.pack("<IiiHHIIiiII", bitmap, width, height, 1, 8 * frames.itemsize, 0, size, 0, 0, 0, 0))
        file.write(setup_block)
        file.write(struct.pack(f"<{count}Q", *(first + n * (8 + size) for n in range(count))))
        for frame in frames:
            file.write(struct.pack("<II", 8, size) + frame[::-1].tobytes())
    return path


def damaged(path, number):
    """The same video with noise in a frame's middle: where PyAV says that frame lies."""
    import av

    with av.open(str(path)) as file:
        packets = [(packet.pos, packet.size) for packet in file.demux(video=0) if packet.size]
    content = bytearray(path.read_bytes())
    place = packets[number - 1][0] + packets[number - 1][1] // 2
    content[place : place + 40] = np.random.default_rng(number).bytes(40)
    broken = path.with_stem("broken")
    broken.write_bytes(content)
    return broken
