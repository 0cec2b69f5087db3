"""Stored maps: what was written comes back, everything else is refused before memory is spent on it."""

import io
import json
import time
import tracemalloc
import zipfile
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile

from correction.masked import _fill, mask_pixels, pixels_in, points_in
from correction.node_status import NodeStatus
from ground.errors import ConfigError, MapFileError
from ground.map_file import load_arrays, save_arrays
from sim.demo.scenes import at_size, demo_scene
from tests.loops import loop_over
from tests.tracer.scenes import ball, camera_at, scene
from tracer.errors import SceneError, StaleMap
from tracer.masked import LEFT_OUT, left_out
from tracer.scene.scene import Scene
from tracer.scene.scene_file import dump_scene, load_scene
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


# A mask drawn as a picture leaves out its white pixels and no others, and is refused where it is none.


H, W = 120, 160
V, U = np.mgrid[:H, :W]
R = np.hypot(U - 70.3, V - 61.7)
SPECKS = np.zeros((H, W), bool)
SPECKS[3, 5] = SPECKS[0] = SPECKS[50:52, 7] = SPECKS[70:80, 70:90] = SPECKS[119, 159] = True
SPECKS[73, 75] = SPECKS[75:77, 80:82] = False  # holes
DRAWN = {
    "disc": R < 40, "outside": R > 40, "ring": (R > 20) & (R < 40), "wall": V > 100, "specks": SPECKS,
    "blobs": cv2.GaussianBlur(np.random.default_rng(0).normal(size=(H, W)), (0, 0), 4.0) > 0.01,
}  # fmt: skip


@pytest.mark.parametrize("name", DRAWN)
def test_white_pixels_are_left_out_and_no_others(tmp_path, name):
    cv2.imwrite(str(tmp_path / "mask.png"), 255 * DRAWN[name].astype(np.uint8))
    parts = left_out(tmp_path / "mask.png", (W, H))
    found = np.zeros((H, W), bool)
    for part in parts:
        assert part.why == LEFT_OUT
        found |= pixels_in(part, (H, W))
    np.testing.assert_array_equal(found, DRAWN[name])
    assert sum(len(part.outline_px) for part in parts) < {"wall": 5, "disc": 250}.get(name, 5000)


def test_pixels_of_an_outline_are_those_whose_middle_is_inside():
    """Row by row as point by point; on whole numbers too, where a middle lies on the outline."""
    rng = np.random.default_rng(1)
    v, u = np.mgrid[:40, :50]
    for number in range(100):
        outline = rng.uniform(-10.0, 60.0, (rng.integers(3, 12), 2))
        outline = np.rint(outline) if number % 3 == 0 else outline
        np.testing.assert_array_equal(_fill(outline, (40, 50)), points_in(outline, np.stack((u, v), axis=-1)))


@pytest.mark.parametrize(
    ("name", "kind", "white"),
    [("a.png", np.uint8, 1), ("a.png", np.uint16, 4095), ("a.tif", np.uint8, 255), ("a.bmp", np.uint8, 1),
     ("a.jpg", np.uint8, 200)],
)  # fmt: skip
def test_any_picture_will_do(tmp_path, name, kind, white):
    cv2.imwrite(str(tmp_path / name), DRAWN["wall"].astype(kind) * white)
    (part,) = left_out(tmp_path / name, (W, H))
    np.testing.assert_array_equal(pixels_in(part, (H, W)), DRAWN["wall"])


def refused(folder):
    white = 255 * DRAWN["disc"].astype(np.uint8)
    cv2.imwrite(str(folder / "small.png"), white[:90, :100])
    cv2.imwrite(str(folder / "black.png"), 0 * white)
    cv2.imwrite(str(folder / "white.png"), 0 * white + 255)
    specks = np.zeros((H, W), np.uint8)
    specks[::2, ::2] = 255
    cv2.imwrite(str(folder / "specks.png"), specks)
    (folder / "noise.png").write_bytes(b"\x89PNG nothing")
    (folder / "empty.png").write_bytes(b"")


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("small.png", "is 100 x 90 px, and the camera 160 x 120; draw it on one of its frames"),
        ("black.png", "leaves out nothing; white is"),
        ("white.png", "leaves out all"),
        ("specks.png", "white areas are 4800"),
        ("noise.png", "damaged, or no picture"),
        ("empty.png", "damaged, or no picture"),
        ("missing.png", "cannot be read: No such file"),
    ],
)
def test_what_is_no_mask_of_this_camera_is_one_sentence(tmp_path, name, words):
    refused(tmp_path)
    with pytest.raises(SceneError, match=words) as caught:
        left_out(tmp_path / name, (W, H))
    assert name in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_scene_file_names_a_picture_that_stands_beside_it(tmp_path):
    scene = at_size(demo_scene("two_spheres_500"), 252)
    picture = np.zeros((252, 252), np.uint8)
    picture[200:, 30:90] = 255
    tifffile.imwrite(tmp_path / "mask.tif", picture)
    read = _loaded(tmp_path, dump_scene(scene) + "masked:\n- {why: left out, picture: mask.tif}\n")
    np.testing.assert_array_equal(mask_pixels(read) == NodeStatus.LEFT_OUT, picture > 0)
    assert _loaded(tmp_path, dump_scene(read)).masked == read.masked
    for entry, words in (
        ("{why: unconfirmed, picture: mask.tif}", "'left out'"),
        ("{why: left out, picture: mask.tif, through: [sphere1]}", "one of them"),
        ("{why: left out, picture: other.tif}", "cannot be read"),
    ):
        with pytest.raises(ConfigError, match=words):
            _loaded(tmp_path, dump_scene(scene) + f"masked:\n- {entry}\n")


def _loaded(folder, text):
    (folder / "scene.yaml").write_text(text)
    return load_scene(folder / "scene.yaml")


@loop_over("name", ["disc", "outside", "specks"])
@loop_over(
    "kind, options",
    [
        (bool, {}),  # tifffile writes it with MinIsWhite
        (bool, {"byteorder": ">"}),
        (bool, {"bigtiff": True}),
        (np.uint8, {"photometric": "miniswhite"}),  # ImageJ's inverted table
        (np.uint8, {"photometric": "minisblack"}),
        (np.uint16, {"photometric": "miniswhite", "bigtiff": True, "byteorder": ">"}),
        (np.float32, {"photometric": "minisblack"}),
    ],
)
def test_numbers_of_a_mask_are_labels_however_they_are_shown(tmp_path, name, kind, options):
    largest = 1 if kind in (bool, np.float32) else np.iinfo(kind).max
    tifffile.imwrite(tmp_path / "mask.tif", (DRAWN[name] * largest).astype(kind), **options)
    found = np.zeros((H, W), bool)
    for part in left_out(tmp_path / "mask.tif", (W, H)):
        found |= pixels_in(part, (H, W))
    np.testing.assert_array_equal(found, DRAWN[name])
