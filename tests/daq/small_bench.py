"""The example bench with a small camera, and everything open on it but the camera's process."""

import re
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import tifffile
import yaml

from daq.bench.bench_file import load_bench
from daq.bench.guards import guard_of
from daq.bench.opened import OpenBench, start_simulation
from daq.cameras.files import FilesCamera
from daq.plans.plan import load_plan
from stages.stage import Stage

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
SIDE_PX = 96
# Where axes stand that have just been switched on: beside the mark that they are homed at, so they find it soon.
BESIDE_MARK_MM = {
    "rail_z": 2.0, "camera_x": 198.0, "camera_y": 198.0, "glass_x": 2.0, "glass_y": 2.0, "glass_z": 2.0,
    "target_x": 48.0, "target_y": 48.0, "target_z": 50.5,
}  # fmt: skip
SCENE = """
camera: {{f_mm: 60.0, L_mm: 500.0, pixel_pitch_um: {pitch_um}, sensor_px: [{side}, {side}]}}
bodies:
  - {{name: near, kind: sphere, centre_mm: [0.0, 0.0, 25.0], radius_mm: 25.0, material: {{n: 1.53}}}}
  - {{name: far, kind: sphere, centre_mm: [0.0, 0.0, 75.0], radius_mm: 25.0, material: {{n: 1.53}}}}
"""
TARGET = "experiment: target\nclear: {z_mm: [0.0, -10.0]}\nglass: {z_mm: [0.0]}\n"
SHIFT = """experiment: shift
views: [clear, glass]
displacements:
  - {along: [1.0, 1.0, 0.0], px: 2.0}
  - {along: [0.0, 0.0, -1.0], mm: 0.5}
"""


def write_bench(folder, side_px=SIDE_PX, simulation="samples: 1", camera=None, is_brisk=True):
    """Write scene.yaml and bench.yaml; return the path of the bench.

    Who interrupts a motion from another process needs axes that take their time: no `brisk` bench.
    """
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "scene.yaml").write_text(SCENE.format(side=side_px, pitch_um=11.0 * 2016 / side_px))
    text = (EXAMPLES / "bench-sim.yaml").read_text()
    text = text.replace("two_spheres_500.yaml", "scene.yaml")
    text = brisk(text) if is_brisk else text
    text = text.replace("  seed: 7\n", "  seed: 7\n" + "".join(f"  {line}\n" for line in simulation.splitlines()))
    if camera is not None:
        text = re.sub(r"^camera:\n(  .*\n)+", camera, text, flags=re.MULTILINE)
    (folder / "bench.yaml").write_text(text)
    return folder / "bench.yaml"


def brisk(text):
    """The example bench, homed and moved with a fifth of the looks at its axes."""
    quick = r"\1speed_mm_s: 50.0, acceleration_mm_s2: 1000.0"
    text = re.sub(r"(, )speed_mm_s: [12]0.0, acceleration_mm_s2: [12]00.0", quick, text)
    text = text.replace('{"23": 0}', '{"23": 0, "120": 1000, "121": 1000}')  # what the portal is set to
    for name, place_mm in BESIDE_MARK_MM.items():
        text = re.sub(
            rf"^(    {name}: {{lead_mm: .*)}}$", rf"\1, power_up_mm: {place_mm}}}", text, flags=re.MULTILINE
        )
    assert text.count("power_up_mm") == len(BESIDE_MARK_MM)
    return text


def load(folder, plan=SHIFT, name="plan", **changes):
    """Write bench and plan and read both."""
    bench = load_bench(write_bench(folder, **changes))
    (folder / f"{name}.yaml").write_text(plan)
    return bench, load_plan(folder / f"{name}.yaml", bench)


GLASS_CHANNELS = {"glass_x": "XY/x", "glass_y": "XY/y", "glass_z": "Z"}
SIMULATED_GLASS = {"devices": {label: {"library": "Simulated", "device": "Stage"} for label in ("XY", "Z")}}


def with_glass(path, glass, **simulation):
    """Let Micro-Manager move the glass of a bench file; a person says where it stands."""
    tree = yaml.safe_load(path.read_text())
    tree["stages"]["controllers"]["glass"] = {"driver": "micromanager", "homing": "hand", **glass}
    for name, channel in GLASS_CHANNELS.items():
        axis = tree["stages"]["axes"][name]
        axis["channel"] = channel
        del axis["steps_per_mm"]
        tree["simulation"]["axes"][name].pop("power_up_mm", None)  # somewhere, as a person left it
    tree["glass"]["retract_mm"]["glass_z"] = 25.0
    tree["simulation"].update(simulation)
    path.write_text(yaml.safe_dump(tree, sort_keys=False))
    return path


def with_grbl_rail(path):
    """Let the Grbl board of the portal move the rail too; it counts from the upper switches."""
    tree = yaml.safe_load(path.read_text())
    del tree["stages"]["controllers"]["rail"], tree["stages"]["axes"]["rail_z"]["steps_per_mm"]
    tree["stages"]["axes"]["rail_z"].update(controller="portal", channel="Z", offset_mm=1750.0)
    tree["simulation"]["axes"]["rail_z"].update(travel_mm=1960.0, origin="high switch", power_up_mm=1900.0)
    path.write_text(yaml.safe_dump(tree, sort_keys=False))
    return path


def with_thorlabs_target(path):
    """Let a Thorlabs rack move the target of a bench file."""
    tree = yaml.safe_load(path.read_text())
    tree["stages"]["controllers"]["target"]["driver"] = "thorlabs_apt"
    for bay, name in enumerate(("target_x", "target_y", "target_z"), 1):
        screw = tree["simulation"]["axes"][name]
        steps_per_mm = screw["steps_per_rev"] / screw["lead_mm"]
        tree["stages"]["axes"][name].update(channel=f"bay{bay}", steps_per_mm=steps_per_mm)
    path.write_text(yaml.safe_dump(tree, sort_keys=False))
    return path


FILES_CAMERA = """camera:
  backend: files
  options: {folder: frames_in}
  settings: {TriggerMode: "On", TriggerSource: Software}
  timeout_s: 0.3
"""


def write_frames(folder, count, side_px=SIDE_PX):
    """A folder of numbered frames for a files camera."""
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(1)
    for number in range(count):
        tifffile.imwrite(folder / f"{number:05d}.tif", rng.integers(0, 4095, (side_px, side_px)).astype(np.uint16))
    return folder


@contextmanager
def files_bench(bench, frames, camera_class=FilesCamera, home=True):
    """Open the simulated stage over byte protocols, and a folder as the camera: no process, no waiting."""
    simulation = start_simulation(bench, "particles")
    try:
        with Stage.open(simulation.sections["stages"], simulation.clock, guard_of(bench)) as stage:
            if home:
                stage.home()
            camera = camera_class(frames)
            camera.open()
            devices, sections = {"stages": stage, "camera": camera}, {"camera": bench.table.camera}
            yield OpenBench(bench, devices, sections, simulation.clock, simulation)
    finally:
        simulation.close()
