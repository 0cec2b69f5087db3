"""Digests of what users compute, kept before a rebuild and compared after each of its steps.

    python -m tests.digests -o digests.json            # or: make digests
    python -m tests.digests --against digests.json     # names what differs; exit 1 if anything does

SHA-256 of the bytes of arrays and records, not of files: ray maps and correction maps of every example scene,
frames, a fit, vectors, means, the journal of a simulated run and what was sent on every wire.  They are made
through the command line and read from its files, so that they outlive modules that move; Python is asked where it
alone has a value.  A digest found again under another name counts as the same, so that names may change.

Digests depend on processor and libraries (the last bit of a sine): they are compared on one computer, and are not
kept in the repository.
"""

import argparse
import contextlib
import hashlib
import io
import json
import math
import os
import re
import shutil
import sys
import tempfile
from pathlib import Path

import numpy as np
import serial
import tifffile
import yaml
from scipy.io import netcdf_file

ROOT = Path(__file__).resolve().parents[1]
SIDE_PX = 168
RUN_PX = 256
SMALL_PIV = ("--first-window", "32", "--final-window", "16")
ONE = ("--workers", "1")
# What differs between two runs of the same: times, places on the disk, and checksums over them.
TIMES = re.compile(r"(_ns|_s|_ms|_ms_mean|_per_writer|seconds|utc|seal|sha256|versions|path|celsius)$")


def digest_of(value):
    """SHA-256 of an array with its kind and shape, of bytes, or of a record."""
    if isinstance(value, np.ndarray):
        head = f"{value.dtype.newbyteorder('=').name} {value.shape} ".encode()
        data = head + value.astype(value.dtype.newbyteorder("<"), order="C").tobytes()
    else:
        data = value if isinstance(value, bytes) else json.dumps(value, sort_keys=True).encode()
    return hashlib.sha256(data).hexdigest()


def rtpiv(*words):
    """Carry a command out in this process; its lines are shown if it fails."""
    from rtpiv.command import main

    sys.argv, said = ["rtpiv", *map(str, words)], io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        code = main()
    if code:
        raise RuntimeError(f"rtpiv {' '.join(sys.argv[1:])} ended with {code}:\n{said.getvalue()[-3000:]}")


def without_times(tree):
    """A record without what differs between two runs of the same."""
    if isinstance(tree, dict):
        return {key: without_times(value) for key, value in tree.items() if not TIMES.search(key)}
    return [without_times(value) for value in tree] if isinstance(tree, list) else tree


def numbers(tree):
    """The numbers of a record in their order, without its words."""
    if isinstance(tree, dict):
        return [number for key in sorted(tree) for number in numbers(tree[key])]
    if isinstance(tree, list):
        return [number for value in tree for number in numbers(value)]
    return [repr(tree)] if isinstance(tree, int | float) and not isinstance(tree, str) else []


def arrays_in(path):
    """Every array of a file that a command has written, by name."""
    if path.suffix == ".nc":
        with netcdf_file(path, mmap=False) as file:
            return {name: variable.data.copy() for name, variable in file.variables.items()}
    if path.suffix == ".npz":
        with np.load(path) as file:
            return {name: np.asarray(file[name]) for name in file.files if file[name].dtype.kind in "biufc"}
    if path.suffix == ".tif":
        return {"pixels": tifffile.imread(path)}
    read = json.loads if path.suffix == ".json" else yaml.safe_load
    return {"numbers": numbers(without_times(read(path.read_text())))}


def files_of(label, folder, *patterns):
    """Digests of all arrays in the files of a folder."""
    paths = sorted(path for pattern in patterns for path in folder.glob(pattern))
    if not paths:
        raise RuntimeError(f"{label}: no {' or '.join(patterns)} was written")
    return {
        f"{label}/{path.relative_to(folder).as_posix()}/{name}": value
        for path in paths
        for name, value in arrays_in(path).items()
    }


def small_scene(path):
    """The text of a scene file with the same view on fewer pixels."""

    def fewer(found):
        factor = max(int(found["w"]), int(found["h"])) / SIDE_PX
        width, height = (round(int(found[key]) / factor) for key in "wh")
        return f"pixel_pitch_um: {float(found['pitch']) * factor!r}, sensor_px: [{width}, {height}]"

    pattern = r"pixel_pitch_um: (?P<pitch>[\d.]+), sensor_px: \[(?P<w>\d+), (?P<h>\d+)\]"
    return re.sub(pattern, fewer, path.read_text())


def scenes():
    """Every example scene."""
    found = sorted((ROOT / "examples").rglob("*.yaml"))
    return [path for path in found if {"camera", "bodies"} <= set(yaml.safe_load(path.read_text()))]


def maps():
    """Ray maps and correction maps of every example scene, as exported and as Python has them."""
    from correction import build_correction_map
    from tracer import build_ray_map, load_scene

    values = {}
    for path in scenes():
        name = "_".join(path.relative_to(ROOT / "examples").with_suffix("").parts)
        file = Path(f"{name}.yaml")
        file.write_text(small_scene(path))
        rtpiv("export", file, "--to", "netcdf", "-o", f"maps_{name}")
        values |= files_of(f"maps/{name}", Path(f"maps_{name}"), "*.nc")
        scene = load_scene(file)
        rays = build_ray_map(scene)
        made = build_correction_map(scene, rays)
        for kind, of, wanted in (
            ("rays", rays, ("plane_mm", "status")),
            ("correction", made, ("status", "pixel", "jacobian", "weight", "transmittance")),
        ):
            values |= {f"maps/{name}/{kind}/{part}": np.asarray(getattr(of, part)) for part in wanted}
            values[f"maps/{name}/{kind}/branches"] = [repr(tuple(branch)) for branch in of.branches]
            values[f"maps/{name}/{kind}/branch"] = np.asarray(of.branch[:]).astype(np.int32)
    return values


def write_pairs(folder, count):
    """Frames of particles that shear, drawn here: nothing of the program decides what they show."""
    folder.mkdir()
    rng = np.random.default_rng(3)
    rows, columns = np.mgrid[:SIDE_PX, :SIDE_PX]
    for number in range(count):
        x, y = rng.uniform(0, SIDE_PX, (2, 700))
        moved = (x + 2.0 + 0.02 * y, y - 1.0 + 0.2 * math.sin(number))
        for letter, places in zip("ab", ((x, y), moved), strict=True):
            image = np.full((SIDE_PX, SIDE_PX), 40.0)
            for u, v in zip(*places, strict=True):
                near = np.s_[max(int(v) - 4, 0) : max(int(v) + 5, 0), max(int(u) - 4, 0) : max(int(u) + 5, 0)]
                image[near] += 800.0 * np.exp(-((columns[near] - u) ** 2 + (rows[near] - v) ** 2) / 2.0)
            tifffile.imwrite(folder / f"B{number:05d}_{letter}.tif", np.rint(image).astype(np.uint16))


def vectors():
    """Corrected frames, vectors of a pair, a series, its mean, and a campaign."""
    from piv import evaluate_pair

    Path("two.yaml").write_text(small_scene(ROOT / "examples" / "two_spheres_500.yaml"))
    write_pairs(Path("pairs"), 12)
    pair = ("pairs/B00000_a.tif", "pairs/B00000_b.tif")
    rtpiv("correct", *pair, "--scene", "two.yaml", "-o", "corrected", "--no-pictures", "--float")
    rtpiv("correct", *pair, "--scene", "two.yaml", "-o", "linear", "--no-pictures", "--method", "bilinear")
    values = files_of("frames/quintic", Path("corrected"), "*.tif")
    values |= files_of("frames/bilinear", Path("linear"), "*.tif")
    single = ("evaluate", *pair, "--scene", "two.yaml", "--dt-us", "100", "--no-pictures")
    rtpiv(*single, "-o", "image", "--tracking", *SMALL_PIV)
    values |= files_of("vectors/image", Path("image"), "*.nc")
    field = evaluate_pair(*(tifffile.imread(path).astype(np.float64) for path in pair))
    for name, value in sorted(vars(field).items()):
        if isinstance(value, np.ndarray):
            values[f"vectors/python/{name}"] = value
    series = ("pairs", "--scene", "two.yaml", "--dt-us", "100", *SMALL_PIV, *ONE, "--prepare", "sliding-minimum")
    rtpiv("mean", *series, "-o", "series", "--ensemble", "16")
    values |= files_of("series", Path("series"), "chunks/*.nc", "*.nc")
    rtpiv("campaign", "run", *series, "-o", "campaign", "--chunk", "8")
    rtpiv("campaign", "merge", "-o", "campaign")
    return values | files_of("campaign", Path("campaign"), "**/*.nc")


@contextlib.contextmanager
def tapped(wires):
    """Keep what is sent on every serial line: each repetition of a message once (polls follow clocks)."""
    original = serial.serial_for_url

    def opened(url, *args, **options):
        port = original(url, *args, **options)
        name = re.sub(r"-[0-9a-f]+$", "", str(url).rpartition("/")[2])  # a line of a bench ends in its own number
        kept, write = wires.setdefault(name, []), port.write

        def noted(data):
            said = re.sub(rb"^T\d+\n$", b"T\n", bytes(data))  # the tool that marks a Grbl board as ours is drawn
            if said not in kept[-1:]:
                kept.append(said)
            return write(data)

        port.write = noted
        return port

    serial.serial_for_url = opened
    try:
        yield
    finally:
        serial.serial_for_url = original


def acquired(label, plan, bench, out, *more):
    """Carry a plan out on the simulated bench: its journal, frames and wires."""
    wires = {}
    with tapped(wires):
        rtpiv("acquire", plan, "--bench", bench, "--simulate", "--home", "-o", out, *more)
    (run,) = (path.parent for path in Path(out).glob("*/steps.jsonl"))
    lines = [json.loads(line) for line in (run / "steps.jsonl").read_text().splitlines()]
    values = {f"{label}/journal/{n:02d}_{line['kind']}": without_times(line) for n, line in enumerate(lines)}
    values |= files_of(label, run, "frames/*.tif", "truth.yaml")
    return run, values | {f"{label}/wires/{name}": b"".join(sent) for name, sent in sorted(wires.items())}


def campaign_of_a_lab():
    """A lab as `init` writes it: target run, fit, shift run with frames corrected as they arrive, vectors."""
    pitch_um = 4.8 * 2048 / RUN_PX
    rtpiv("init", "lab", "--yes", "--sensor-px", RUN_PX, RUN_PX, "--pixel-pitch-um", pitch_um, "--gap-mm", "1")
    bench = "lab/bench.yaml"
    target, values = acquired("target", "lab/plan-target.yaml", bench, "targets")
    rtpiv("calibrate", target, "-o", "fit", "--no-pictures")
    values |= files_of("fit", Path("fit"), "*.npz", "*.json", "scene.yaml")
    shift, more = acquired("shift", "lab/plan-shift.yaml", bench, "shifts", "--scene", "fit/scene.yaml")
    values |= more | files_of("shift", shift, "corrected/*.tif")
    rtpiv("evaluate", shift, "--scene", "fit/scene.yaml", "-o", "shift", "--no-pictures", *SMALL_PIV)
    return values | files_of("shift/vectors", Path("shift"), "**/*.nc")


def other_wires():
    """Stage controllers that no lab of `init` has, and shots of every timing unit."""
    from tests.daq import small_bench
    from tests.daq.timing import quantum_desk as composers
    from tests.daq.timing import test_pivlab_synchroniser as pivlab

    path = small_bench.write_bench(Path("apt"))
    small_bench.with_grbl_rail(small_bench.with_thorlabs_target(path))
    Path("apt/plan.yaml").write_text(small_bench.SHIFT)
    _, values = acquired("apt", "apt/plan.yaml", path, "apt/runs", "--no-correct")
    wires = {}
    with tapped(wires):
        for name, wiring in (("lamps", composers.WIRING), ("diodes", composers.PUMPED)):
            head = composers.HEAD if name == "lamps" else composers.LaserHead(max_rate_hz=15.0)
            with contextlib.ExitStack() as up:
                desk = composers.Desk(wiring, head)
                composers.LINES["desk"] = desk.line
                up.callback(composers.LINES.pop, "desk")
                desk.burst()
                desk.laser.close()
            values[f"shots/quantum_composers {name}"] = b"".join(wires.pop("desk"))
        for driver in (pivlab.OltSyncBox, pivlab.XmSyncBox):
            with pivlab.desk(driver) as (laser, *_):
                pivlab.to_armed(laser)
                laser.fire(5)
                laser.wait()
                laser.close()
            values[f"shots/{driver.__name__}"] = b"".join(wires.pop("desk"))
    return values


PARTS = (maps, vectors, campaign_of_a_lab, other_wires)


def differences(kept, made):
    """What differs, by name; what is found again under another name does not."""
    there = set(made.values())
    lost = [
        f"changed or gone: {name}" for name in kept if made.get(name) != kept[name] and kept[name] not in there
    ]
    return lost + [f"new: {name}" for name in sorted(made.keys() - kept.keys()) if made[name] not in kept.values()]


def main():
    """Make digests; write or compare them."""
    parser = argparse.ArgumentParser(description="digests of what users compute")
    parser.add_argument("-o", "--out", type=Path, help="write them here")
    parser.add_argument("--against", type=Path, help="name what differs from this file")
    asked = parser.parse_args()
    out, against = (path and path.resolve() for path in (asked.out, asked.against))
    made, folder, here = {}, Path(tempfile.mkdtemp(prefix="digests-")), Path.cwd()
    try:
        for part in PARTS:
            (folder / part.__name__).mkdir()
            os.chdir(folder / part.__name__)
            made |= {name: digest_of(value) for name, value in part().items()}
            print(
                f"{part.__name__}: {len(made)} digests after {sum(os.times()[:4]):.0f} s of processor time",
                flush=True,
            )
    finally:
        os.chdir(here)
        shutil.rmtree(folder)
    if out:
        out.write_text(json.dumps(made, indent=1, sort_keys=True) + "\n")
    found = differences(json.loads(against.read_text()), made) if against else []
    print(*found, f"{len(made)} digests" + (f", {len(found)} differ" if against else ""), sep="\n")
    return bool(found)


if __name__ == "__main__":
    sys.exit(main())
