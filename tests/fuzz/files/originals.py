"""One whole file of every kind that rtpiv reads, as small as it can be, and who reads it."""

import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import tifffile

from correction.fitted.map_sigma import MapSigma
from correction.fitted.scene_sigma import KIND as FIT
from correction.fitted.scene_sigma import SceneSigma
from correction.grid import grid_of
from correction.maps.correction_map import CorrectionMap, build_correction_map
from daq.bench.bench_file import load_bench
from daq.bench.guards import idle_stage
from daq.plans.forecast import forecast
from daq.plans.plan import load_plan
from daq.runs.acquired import read_acquired
from daq.runs.done_file import read_done
from daq.runs.pairs import pairs_of
from daq.runs.raw_frame import read_raw, write_raw
from daq.runs.run_check import check_run
from daq.runs.run_folder import RunFolder
from daq.runs.run_views import board_of, first_view, scene_file, target_views
from ground.map_file import save_arrays
from piv.files.frame_file import read_frame, write_frame
from rtpiv.analysis.pairs.piv_file import piv_choice
from rtpiv.analysis.series.run_series import run_series
from rtpiv.analysis.series.series_folder import Chunks
from rtpiv.analysis.series.series_view import SeriesView
from tests.daq.whole_run import make_whole_run
from tests.fuzz.files import damage
from tests.rtpiv.analysis.series.small_series import flow_run, given_of, method_of, series_of
from tracer.scene.scene_file import dump_scene, load_priors, load_scene
from tracer.strategies.ray_map import RayMap, build_ray_map

SCENE = """wavelength_nm: 532.0
ambient: {n: 1.0}
glasses: {crown: {n: 1.53}}
camera:
  f_mm: 60.0
  L_mm: 500.0
  pixel_pitch_um: 900.0
  sensor_px: [24, 20]
  position_mm: [0.0, 0.0, 500.0]
  look_at_mm: [0.0, 0.0, 0.0]
  lens: {k1: 0.01}
bodies:
  - {name: near, kind: sphere, centre_mm: [0.0, 0.0, 25.0], radius_mm: 25.0, material: crown,
     core: {radius_mm: 20.0, material: air}}
  - {name: rest, kind: rod, start_mm: [0.0, -40.0, 10.0], end_mm: [0.0, -60.0, 10.0], radius_mm: 4.0}
fit:
  spheres: {centre_mm: 1.0, radius_mm: 0.02}
"""
_CAMERA = """camera: {focal_px: 33.0, sensor_px: [24, 20], position_mm: [0.0, 0.0, 500.0], lens: {k1: 0.0}}
"""
_BALL = "  - {name: a, kind: sphere, centre_mm: [0.0, 0.0, 25.0], radius_mm: 25.0, material: {n: 1.5}}\n"
_ROD = "  - {name: rest, kind: rod, start_mm: [0.0, -40.0, 10.0], end_mm: [0.0, -60.0, 10.0], radius_mm: 4.0}\n"
WARM = (
    SCENE.replace(_ROD, ""),
    SCENE.replace(_ROD, "").replace("  lens: {k1: 0.01}\n", ""),
    _CAMERA,
    f"{_CAMERA}bodies:\n{_BALL}",
    f"{_CAMERA}bodies:\n{_ROD}",
    f"{_CAMERA}bodies:\n{_BALL}{_ROD}",
)
BENCH = """name: bench
scene: scene.yaml
scene_at_mm: {rail_z: 500.0}
stages:
  controllers: {box: {driver: zaber_ascii, port: /dev/none}}
  axes:
    target_x: {controller: box, channel: 1/1, carries: target, along: x, limits_mm: [-9.0, 9.0],
               speed_mm_s: 1.0, acceleration_mm_s2: 1.0, steps_per_mm: 1000.0}
    target_z: {controller: box, channel: 1/2, carries: target, along: z, limits_mm: [-90.0, 9.0],
               speed_mm_s: 1.0, acceleration_mm_s2: 1.0, steps_per_mm: 1000.0}
    rail_z: {controller: box, channel: 2/1, carries: camera, along: z, limits_mm: [0.0, 900.0],
               speed_mm_s: 1.0, acceleration_mm_s2: 1.0, steps_per_mm: 1000.0}
    glass_y: {controller: box, channel: 2/2, carries: glass, along: y, limits_mm: [-200.0, 9.0],
               speed_mm_s: 1.0, acceleration_mm_s2: 1.0, steps_per_mm: 1000.0}
  home_order: [rail_z, glass_y, target_z, target_x]
glass:
  out_mm: {glass_y: -120.0}
camera:
  backend: files
  options: {folder: frames_in}
  settings: {TriggerMode: "On"}
  timeout_s: 5.0
target: {square_mm: 2.5, disc_mm: 1.0}
"""
PLANS = {
    "target": "experiment: target\nclear: {z_mm: [0.0, -10.0]}\nglass: {z_mm: [0.0]}\nframes: 2\nsettle_s: 0.2\n",
    "shift": "experiment: shift\nviews: [clear, glass]\ndisplacements:\n  - {along: [1.0, 0.0, 0.0], px: 2.0}\n"
    "  - {along: [0.0, 0.0, -1.0], mm: 0.5}\nrepeats: 2\n",
    "stream": "experiment: stream\nview: glass\nframes: 10\ngroup: 2\n",
}
PIV = """first_window_px: 64
final_window_px: 32
passes: 4
overlap: 0.5
window: gaussian
denoise: 2.0
prepare: [sliding-minimum, min-max]
"""
SMALL_PX = 64  # a side of a sensor up to which a scene is traced as well


@dataclass(frozen=True)
class Original:
    """A whole file, who reads it (called with the folder of all originals), and what may happen to it."""

    path: str
    read: Callable[[Path], object]
    damages: tuple[Callable[..., bytes], ...]
    share: int = 4  # of all cases


def of_text(text):
    """Damage of a text as damage of bytes."""

    def changed(data, rng):
        return text(data.decode(), rng).encode("utf-8", "surrogatepass")

    return changed


TEXT = (of_text(damage.damaged_text), of_text(damage.damaged_text), damage.damaged)
RECORD = (damage.damaged_record, damage.damaged)
LINES = (damage.damaged_lines, damage.damaged)
MAP = (damage.damaged_map, damage.damaged_map, damage.damaged_npy_header, damage.damaged)
TIFF = (damage.damaged_tiff, damage.damaged_tiff, damage.damaged)


def scene_read(folder):
    scene = load_scene(folder / "scene.yaml")
    load_priors(folder / "scene.yaml")
    scene.content_hash(), dump_scene(scene), grid_of(scene.camera)
    if max(scene.camera.sensor_px) <= SMALL_PX and len(scene.bodies) < 10:
        build_correction_map(scene, build_ray_map(scene))


def bench_read(folder):
    bench = load_bench(folder / "bench.yaml")
    idle_stage(bench), bench.home_mm
    plan = load_plan(folder / "target.yaml", bench)
    forecast(bench, idle_stage(bench), plan.steps)


def plan_read(name):
    def read(folder):
        bench = load_bench(folder / "bench.yaml")
        plan = load_plan(folder / f"{name}.yaml", bench)
        forecast(bench, idle_stage(bench), plan.steps)

    return read


def run_read(folder):
    """What `report`, `evaluate`, `calibrate` and `check` read."""
    run = RunFolder.open(folder / "run")
    (
        run.entries(),
        read_done(run),
        first_view(run),
        pairs_of(run.path),
        target_views(run.path),
        board_of([run.path]),
    )
    scene_file(run.path, folder / "run_out")


def run_checked(folder):
    found = check_run(folder / "run")
    assert all("\n" not in finding.said for finding in found.findings)


def run_frame(folder):
    read_acquired(folder / "run" / "frames" / "000003.tif")


def series_read(folder):
    chunks, view = Chunks.of(folder / "series"), SeriesView(folder / "series")
    list(chunks), view.windows, view.scene


def frame_read(name):
    return lambda folder: read_frame(folder / name)


ORIGINALS = (
    Original("scene.yaml", scene_read, TEXT, 12),
    Original("bench.yaml", bench_read, TEXT, 6),
    *(Original(f"{name}.yaml", plan_read(name), TEXT, 3) for name in PLANS),
    Original("piv.yaml", lambda folder: piv_choice(piv=folder / "piv.yaml"), TEXT, 6),
    Original("run/run.json", run_read, RECORD, 8),
    Original("run/steps.jsonl", run_read, LINES, 6),
    Original("run/displacements.json", run_read, LINES, 4),
    Original("run/done.json", run_read, RECORD, 4),
    Original("run/steps.jsonl", run_checked, LINES, 2),
    Original("run/frames/000003.tif", run_frame, TIFF, 6),
    Original("series/series.json", series_read, TEXT, 4),
    Original("series/chunks/00000.json", series_read, TEXT, 4),
    Original("series/chunks/00000.nc", series_read, (damage.damaged,), 2),
    Original("ray_map.npz", lambda folder: RayMap.load(folder / "ray_map.npz"), MAP, 8),
    Original("map.npz", lambda folder: CorrectionMap.load(folder / "map.npz"), MAP, 8),
    Original("fit.npz", lambda folder: SceneSigma.load(folder / "fit.npz"), MAP, 8),
    Original("map_sigma.npz", lambda folder: MapSigma.load(folder / "map_sigma.npz"), MAP, 8),
    Original("plain.tif", frame_read("plain.tif"), TIFF, 10),
    Original("zlib.tif", frame_read("zlib.tif"), TIFF, 8),
    Original("lzw.tif", frame_read("lzw.tif"), TIFF, 8),
    Original("corrected.tif", frame_read("corrected.tif"), TIFF, 4),
    Original("raw.tif", lambda folder: read_raw(folder / "raw.tif"), TIFF, 6),
    Original("grey.png", frame_read("grey.png"), (damage.damaged,), 8),
    Original("grey.bmp", frame_read("grey.bmp"), (damage.damaged,), 6),
    Original("grey.jpg", frame_read("grey.jpg"), (damage.damaged,), 8),
    Original("grey.pgm", frame_read("grey.pgm"), (damage.damaged,), 6),
)


def write_originals(folder):
    """Write every file that `ORIGINALS` names; takes some seconds."""
    (folder / "scene.yaml").write_text(SCENE)
    (folder / "bench.yaml").write_text(BENCH)
    (folder / "piv.yaml").write_text(PIV)
    for name, text in PLANS.items():
        (folder / f"{name}.yaml").write_text(text)
    scene = load_scene(folder / "scene.yaml")
    ray_map = build_ray_map(scene)
    ray_map.save(folder / "ray_map.npz")
    build_correction_map(scene, ray_map).save(folder / "map.npz")
    rng, scene_hash = np.random.default_rng(1), scene.content_hash()
    header = {
        "names": ["a", "b"],
        "scene_hash": scene_hash,
        "nominal_hash": scene_hash,
        "frames": [],
        "history": [],
    }
    arrays = {"values": rng.normal(size=2), "covariance": np.eye(2), "scene_root": rng.normal(size=(19, 2))}
    save_arrays(folder / "fit.npz", FIT, header, arrays)
    sigma = rng.random((5, 6, 2)).astype(np.float32)
    MapSigma(grid_of(scene.camera), sigma, sigma[..., 0] > 0.5, 0.1, scene_hash).save(folder / "map_sigma.npz")
    _write_frames(folder, rng)
    with_run = folder / "whole"
    with_run.mkdir()
    shutil.copytree(make_whole_run(with_run).path, folder / "run")
    flow = flow_run(folder, 3)
    (folder / "series").mkdir()
    run_series(series_of(folder / "series", given_of(flow), method_of(folder / "series")), 1, 2)


def _write_frames(folder, rng):
    frame = rng.integers(0, 4096, (20, 24)).astype(np.uint16)
    tifffile.imwrite(folder / "plain.tif", frame)
    tifffile.imwrite(folder / "zlib.tif", frame, compression="zlib", predictor=True)
    cv2.imwrite(str(folder / "lzw.tif"), frame, [cv2.IMWRITE_TIFF_COMPRESSION, 5])
    write_frame(folder / "corrected.tif", frame.astype(np.float32), 10.0, {"origin_mm": [0.0, 0.0]})
    write_raw(folder / "raw.tif", frame, {"frame_id": 1, "bits": 12})
    cv2.imwrite(str(folder / "grey.png"), frame)
    for name in ("grey.bmp", "grey.jpg", "grey.pgm"):
        cv2.imwrite(str(folder / name), (frame >> 4).astype(np.uint8))
