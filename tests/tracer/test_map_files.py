"""Stored maps: what was written comes back, everything else is refused before memory is spent on it."""

import io
import json
import time
import tracemalloc
import zipfile
from pathlib import Path

import numpy as np
import pytest

from ground.errors import MapFileError
from ground.map_file import load_arrays, save_arrays
from tests.loops import loop_over
from tests.tracer.scenes import ball, camera_at, scene
from tracer.errors import StaleMap
from tracer.scene.scene import Scene
from tracer.strategies.ray_map import KIND, RayMap, build_ray_map


def small_scene(x_mm: float = 0.0) -> Scene:
    camera = camera_at((0.0, 0.0, 300.0), focal_px=150.0, sensor_px=(40, 30))
    return Scene(camera, (ball("one", x_mm, 0.0, 20.0, 20.0), ball("post", 40.0, 0.0, 9.0, 8.0, None)))


@pytest.fixture
def stored(tmp_path: Path) -> Path:
    path = tmp_path / "scene.map"
    build_ray_map(small_scene()).save(path)
    return path


def test_round_trip(stored: Path) -> None:
    made, read = build_ray_map(small_scene()), RayMap.load(stored)
    for name in ("plane_mm", "status", "branch"):
        assert getattr(made, name).tobytes() == getattr(read, name).tobytes()
    assert (read.branches, read.scene_hash) == (made.branches, made.scene_hash)
    assert read.branches == ((), ("one",))
    read.check(small_scene())


@pytest.mark.slow
def test_short_numbers_are_the_long_ones_rounded_once(tmp_path: Path) -> None:
    for where in (small_scene(), scene("pyramid_500").with_camera(small_scene().camera)):  # by march, in lockstep
        long, short = build_ray_map(where), build_ray_map(where, single=True)
        assert short.plane_mm.dtype == np.float32
        assert np.array_equal(long.plane_mm.astype(np.float32), short.plane_mm, equal_nan=True)
        assert np.array_equal(long.status, short.status)
        assert np.array_equal(long.branch, short.branch)
        assert build_ray_map(where, short, single=True).plane_mm is short.plane_mm
        assert build_ray_map(where, short).plane_mm.tobytes() == long.plane_mm.tobytes()
        short.save(tmp_path / "short.map")
        assert RayMap.load(tmp_path / "short.map").plane_mm.tobytes() == short.plane_mm.tobytes()


def test_another_scene_is_refused_by_name(stored: Path) -> None:
    other = small_scene(0.001)
    with pytest.raises(StaleMap, match=f"{small_scene().content_hash()}, not to {other.content_hash()}"):
        RayMap.load(stored).check(other)


def test_writing_is_atomic(stored: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = stored.read_bytes()

    def full_disk(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez", full_disk)
    with pytest.raises(OSError, match="No space"):
        build_ray_map(small_scene()).save(stored)
    assert stored.read_bytes() == before
    assert [path.name for path in stored.parent.iterdir()] == [stored.name]


def test_truncated_anywhere(stored: Path) -> None:
    content = stored.read_bytes()
    for length in [*range(0, len(content), len(content) // 60), len(content) - 1]:
        stored.write_bytes(content[:length])
        with pytest.raises(MapFileError, match="damaged or no map file"):
            RayMap.load(stored)


def test_every_flipped_bit_is_refused_or_harmless(tmp_path: Path) -> None:
    """A flipped bit anywhere is refused, or sits in a field that no array depends on."""
    path = tmp_path / "tiny"
    made = build_ray_map(Scene(camera_at((0.0, 0.0, 300.0), focal_px=150.0, sensor_px=(3, 2))))
    made.save(path)
    content = path.read_bytes()
    refused = 0
    for bit in range(0, 8 * len(content), 7):
        damaged = bytearray(content)
        damaged[bit // 8] ^= 1 << bit % 8
        path.write_bytes(damaged)
        try:
            read = RayMap.load(path)
        except MapFileError:
            refused += 1
            continue
        for name in ("plane_mm", "status", "branch"):
            assert getattr(read, name).tobytes() == getattr(made, name).tobytes()
        assert (read.scene_hash, read.branches) == (made.scene_hash, made.branches)
    assert refused > len(content) // 2


def test_missing_file_and_other_content(tmp_path: Path) -> None:
    with pytest.raises(MapFileError, match="cannot be read"):
        RayMap.load(tmp_path / "missing.map")
    for content in (b"", b"PK", b"\x89PNG" * 50, b"x" * 10_000):
        path = tmp_path / "other"
        path.write_bytes(content)
        with pytest.raises(MapFileError, match="damaged or no map file"):
            RayMap.load(path)


def test_other_kind_and_layout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "file"
    save_arrays(path, "correction map", {}, {"a": np.zeros(3)})
    with pytest.raises(MapFileError, match="holds a correction map, not a ray map"):
        RayMap.load(path)
    monkeypatch.setattr("ground.map_file.LAYOUT", 99)
    save_arrays(path, KIND, {}, {"a": np.zeros(3)})
    monkeypatch.undo()
    with pytest.raises(MapFileError, match="has layout 99"):
        RayMap.load(path)


def member(array: np.ndarray, shape: str | None = None) -> bytes:
    """An .npy member, its declared shape replaced by a lie of the same length where asked."""
    stream = io.BytesIO()
    np.save(stream, array)
    content = stream.getvalue()
    if shape is not None:
        header = content.index(b"'shape':")
        end = content.index(b"\n", header)
        text = b"'shape': " + shape.encode() + b", }"
        content = content[:header] + text.ljust(end - header) + content[end:]
    return content


def hostile(path: Path, **members: bytes) -> Path:
    header = {"kind": KIND, "layout": 1, "scene_hash": "x", "branches": [[]]}
    good = {
        "header": member(np.frombuffer(json.dumps(header).encode(), np.uint8)),
        "plane_mm": member(np.zeros((4, 5, 2))),
        "status": member(np.zeros((4, 5), np.uint8)),
        "branch": member(np.zeros((4, 5), np.uint16)),
    }
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in (good | members).items():
            archive.writestr(f"{name}.npy", content)
    return path


def pickled() -> bytes:
    stream = io.BytesIO()
    np.save(stream, np.array([{"a": 1}, None], dtype=object), allow_pickle=True)
    return stream.getvalue()


def header_of(**changes: object) -> bytes:
    header = {"kind": KIND, "layout": 1, "scene_hash": "x", "branches": [[]]} | changes
    return member(np.frombuffer(json.dumps(header).encode(), np.uint8))


def test_the_hostile_files_below_differ_from_a_good_one_in_one_thing(tmp_path: Path) -> None:
    assert RayMap.load(hostile(tmp_path / "good")).plane_mm.shape == (4, 5, 2)


@loop_over(
    "members",
    [
        {"plane_mm": pickled()},
        {"header": pickled()},
        {"plane_mm": member(np.zeros((4, 5, 2)), "(400000000, 5, 2)")},
        {"plane_mm": member(np.zeros((4, 5, 2)), "(-4, -5, 2)")},
        {"plane_mm": member(np.zeros((4, 5, 2)), "(4, 5)")},
        {"plane_mm": member(np.zeros((4, 5, 2)), "(0, 99999999999999)")},
        {"plane_mm": member(np.zeros((4, 5, 2)), "(4, 5, 2.0)")},
        {"plane_mm": member(np.zeros((4, 5, 2)), "(True, 40)")},
        {"plane_mm": member(np.asfortranarray(np.zeros((4, 5, 2))))},
        {"plane_mm": b"\x93NUMPY\x03\x00" + b"\xff\xff\xff\x7f" + b" " * 100},
        {"plane_mm": b"\x93NUMPY\x01\x00\xff\xff" + b"(" * 60_000},
        {"plane_mm": b"not an array"},
        {"plane_mm": member(np.zeros((4, 6, 2)))},
        {"plane_mm": member(np.zeros((4, 5, 2), np.float16))},
        {"plane_mm": member(np.zeros((4, 5, 2), ">f8"))},
        {"status": member(np.zeros((4, 5), np.int8))},
        {"status": member(np.full((4, 5), 77, np.uint8))},
        {"branch": member(np.ones((4, 5), np.uint16))},
        {"header": member(np.frombuffer(b"{", np.uint8))},
        {"header": member(np.frombuffer(b"[1]", np.uint8))},
        {"header": member(np.frombuffer(b"[" * 100_000, np.uint8))},
        {"header": member(np.frombuffer(b"\xff\xfe", np.uint8))},
        {"header": header_of(branches=5)},
        {"header": header_of(branches=[5])},
        {"header": header_of(branches=[])},
        {"header": header_of(layout="1")},
    ],
)
def test_hostile_members(members: dict[str, bytes], tmp_path: Path) -> None:
    path = hostile(tmp_path / "hostile", **members)
    tracemalloc.start()
    with pytest.raises(MapFileError):
        RayMap.load(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 10_000_000


def test_missing_members(tmp_path: Path) -> None:
    path = tmp_path / "few"
    save_arrays(path, KIND, {"scene_hash": "x", "branches": [[]]}, {"plane_mm": np.zeros((4, 5, 2))})
    with pytest.raises(MapFileError, match="lacks 'status'"):
        RayMap.load(path)
    save_arrays(path, KIND, {"branches": [[]]}, {n: np.zeros(3) for n in ("plane_mm", "status", "branch")})
    with pytest.raises(MapFileError, match="lacks 'scene_hash'"):
        RayMap.load(path)


def test_compressed_members_are_refused(tmp_path: Path) -> None:
    """A compressed member can be a bomb: a few bytes that unpack to gigabytes."""
    path = tmp_path / "bomb"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("plane_mm.npy", member(np.zeros((2000, 2000))))
    with pytest.raises(MapFileError, match="not stored plainly"):
        load_arrays(path, KIND)


def test_same_bytes_every_time(tmp_path: Path) -> None:
    """A map is a value: the same scene gives the same arrays and header, byte for byte."""
    for name in ("a", "b"):
        build_ray_map(small_scene()).save(tmp_path / name)
    one, two = (load_arrays(tmp_path / name, KIND) for name in ("a", "b"))
    assert one[0] == two[0]
    assert all(one[1][name].tobytes() == two[1][name].tobytes() for name in one[1])


@pytest.mark.parametrize(
    "shape", [b"9" * 30 + b" 8", b"1 2 " * 20, b"3, " * 12, b"4,, 4", b"12345678901234567890"]
)
def test_a_shape_in_no_form_of_numpy_s_is_refused_at_once(tmp_path, shape):
    """A row of digits can be cut into numbers in very many ways; a reader that tries them all never comes back."""
    path = tmp_path / "a.map"
    save_arrays(path, "ray map", {}, {"a": np.zeros((3, 4))})
    with zipfile.ZipFile(path) as archive:
        members = {info.filename: archive.read(info) for info in archive.infolist()}
    text = b"{'descr': '<f8', 'fortran_order': False, 'shape': (" + shape + b"), } \n"
    whole = members["a.npy"]
    members["a.npy"] = whole[:8] + len(text).to_bytes(2, "little") + text + whole[-96:]
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    begun_s = time.process_time()
    with pytest.raises(MapFileError, match="is not described as numpy does it"):
        load_arrays(path, "ray map")
    assert time.process_time() - begun_s < 1.0
