"""Damage to files: what disks, copies and people do to them, drawn from a generator so that it can be done again.

of bytes      flipped bits, holes, zeros, doubled and lost parts, a lost end
of texts      another value for a key, lines lost, doubled, swapped or repeated thousands of times, deep nesting
of records    the same to the text of a sealed record, which is sealed again: the types alone have to find it
of maps       the same to the header of a map file; arrays of another type, shape or value
of TIFF       numbers in the directory of tags
of the file   gone, a folder, a pipe, a device without end, a link to itself, no permission, nothing in it
"""

import io
import json
import os
import re
import struct
import zipfile

import numpy as np

from daq.runs.seal import add_seal

WORDS = (b"NaN", b"-1", b"1e999", b"null", b"true", b'"x"', b"[]", b"{}", b"\0", b"\xff", b"9" * 30, b"\n", b"../")
VALUES = (
    "[1]", "{}", "[]", "null", "true", "0", "-1", "1", "0.0", "-0.0", "1.0e-300", "1.0e+300", "9" * 25, "9" * 5000,
    "65535", "1000000000", '""', '"x"', '"\\u0000"', '"\\u001b[2J"', '"$x_2$"', '"a\\\\b"', '"../../etc/passwd"',
    '"/dev/zero"', "a" * 300, "a" * 100_000, "[" * 60, "[" * 5000, "{a: " * 200, "on", "010", "12:30", "1e-3",
    "20,5", '"20,5"', "0.0055", "5500.0", "1.0e+6", "1.0e+9", "70000", "1 mm", '"\\ud800"', '"os:system"',
    '"subprocess:Popen"', "diameter_mm",
    "!!x y", "&a [*a]", "<<: 1", "\t", "\x07", "\x1b[31m", "\N{GRINNING FACE}",
)  # fmt: skip
KINDS = ("<f8", "<f4", ">f8", "<c16", "|u1", "<u2", "<i8", "|b1", "<U4")
_TOKEN = re.compile(r'"[^"\n]*"|[\w.+-]+')


def damaged(data, rng):
    """Return `data` with one kind of damage to its bytes at a random place; never equal to it."""
    while (result := _once_damaged(data, rng)) == data:
        pass
    return result


def _once_damaged(data, rng):
    place, length = rng.randrange(len(data)), rng.choice((1, 1, 2, 8, 100, 5000))
    end = min(len(data), place + length)
    before, hit, after = data[:place], data[place:end], data[end:]
    return rng.choice((
        before + bytes([hit[0] ^ (1 << rng.randrange(8))]) + hit[1:] + after,
        before + rng.randbytes(len(hit)) + after,
        before + bytes(len(hit)) + after,
        before + after,
        before + rng.choice(WORDS) + hit + after,
        before + rng.choice(WORDS) + after,
        before + hit + hit + after,
        before,
    ))  # fmt: skip


def damaged_text(text, rng):
    """Return a text of keys and values with another value, or with lines that were moved, lost or repeated."""
    tokens, lines = list(_TOKEN.finditer(text)), text.split("\n")
    kind, place = rng.randrange(8), rng.randrange(len(lines))
    if kind < 4 and tokens:
        token = rng.choice(tokens)
        value = rng.choice(VALUES) if kind else rng.choice(tokens)[0]
        return text[: token.start()] + value + text[token.end() :]
    if kind == 4:
        del lines[place]
    elif kind == 5:
        lines[place:place] = [lines[place]] * rng.choice((1, 1, 2, 20_000))
    elif kind == 6:
        other = rng.randrange(len(lines))
        lines[place], lines[other] = lines[other], lines[place]
    else:
        lines.insert(place, rng.choice(VALUES))
    return "\n".join(lines)


def damaged_record(record, rng):
    """Damage the text of a sealed record, and seal what has come of it."""
    body = re.sub(rb',\s*"seal":\s*"[0-9a-f]{8}"\s*\}\s*\Z', b"}", record)
    text = damaged_text(body.decode(), rng).encode()
    return add_seal(text) if text.rstrip().endswith(b"}") and len(text) > 4 else text


def damaged_lines(data, rng):
    """Damage one sealed record of a file that has one in every line."""
    lines = data.split(b"\n")
    places = [place for place, line in enumerate(lines) if line.startswith(b"{")]
    place = rng.choice(places)
    comma = b"," if lines[place].endswith(b",") else b""
    lines[place] = damaged_record(lines[place].removesuffix(b","), rng).replace(b"\n", b" ") + comma
    if rng.random() < 0.2:
        other = rng.choice(places)
        lines[place], lines[other] = lines[other], lines[place]
    return b"\n".join(lines)


def damaged_map(data, rng):
    """Damage the header of a map file, or one of its arrays."""
    with np.load(io.BytesIO(data)) as file:
        arrays = dict(file)
    header = arrays.pop("header").tobytes().decode()
    name, kind = rng.choice(sorted(arrays)), rng.randrange(7)
    array = arrays[name]
    if kind < 3:
        header = damaged_text(json.dumps(json.loads(header), indent=0), rng)
    elif kind == 3:
        with np.errstate(all="ignore"):
            arrays[name] = array.astype(
                rng.choice(("<f8", "<f4", ">f8", "<c16", "|u1", "<u2", "<i8", "|b1", "<U4"))
            )
    elif kind == 4:
        arrays[name] = rng.choice((array[..., :0], array.ravel(), array[None], array[:1], np.zeros(())))
    elif kind == 5 and array.size:
        value = rng.choice((np.nan, np.inf, -1.0, 1e300, 255.0, 65535.0))
        with np.errstate(all="ignore"):
            array.ravel()[rng.randrange(array.size)] = np.asarray(value).astype(array.dtype)
    else:
        arrays[rng.choice(("more", "../up", name + "2"))] = arrays.pop(name)
    out = io.BytesIO()
    with np.errstate(all="ignore"):
        np.savez(out, header=np.frombuffer(header.encode("utf-8", "surrogatepass"), np.uint8), **arrays)
    return out.getvalue()


def damaged_npy_header(data, rng):
    """Damage the text that says what an array of a map file holds."""
    parts = {}
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        for info in archive.infolist():
            parts[info.filename] = archive.read(info)
    name = rng.choice(sorted(parts))
    length = struct.unpack("<H", parts[name][8:10])[0]
    text = damaged(parts[name][10 : 10 + length], rng)
    length = len(text) if rng.random() < 0.5 else length
    parts[name] = parts[name][:8] + struct.pack("<H", min(length, 65535)) + text + parts[name][10 + length :]
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        for member, content in parts.items():
            archive.writestr(member, content)
    return out.getvalue()


def damaged_tiff(data, rng):
    """Change tag, type, count or value of an entry in the first directory of a TIFF."""
    start = struct.unpack("<I", data[4:8])[0]
    entries = struct.unpack("<H", data[start : start + 2])[0]
    place = start + 2 + 12 * rng.randrange(entries)
    code, kind, count, value = struct.unpack("<HHII", data[place : place + 12])
    number = rng.choice((0, 1, 2, 3, 4, 8, 12, 32, 255, 40_000, 65_535, 2**31, 2**32 - 1, rng.getrandbits(32)))
    which = rng.randrange(6)
    if which == 0:
        code = rng.choice((256, 257, 258, 259, 262, 266, 273, 274, 277, 278, 279, 284, 317, 320, 338, 339, 322))
    elif which == 1:
        kind = number % 20
    elif which == 2:
        count = number
    else:
        value = number
    return data[:place] + struct.pack("<HHII", code, kind, count, value) + data[place + 12 :]


def spoil_file(path, data, rng):
    """Put something in the place of a file that is none, or one without the contents."""
    kind = rng.randrange(7)
    if kind == 0:
        return
    if kind == 1:
        path.mkdir()
    elif kind == 2:
        os.mkfifo(path)
    elif kind == 3:
        path.symlink_to("/dev/zero")
    elif kind == 4:
        path.symlink_to(path.name)
    elif kind == 5:
        path.symlink_to("/dev/null")
    else:
        path.write_bytes(b"")
