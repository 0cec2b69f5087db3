"""The example bench that hands move, with a small camera."""

from pathlib import Path

import yaml

from tests.daq.flow_bench import DIODES, PLAN, write_flow
from tests.daq.small_bench import SCENE, SIDE_PX, write_frames

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
SHIFT = "experiment: shift\nviews: [glass]\ndisplacements:\n  - {along: [1.0, 0.0, 0.0], mm: 1.0}\n"


def write_hand_bench(folder, side_px=SIDE_PX, plan=SHIFT, **simulation):
    """Write scene.yaml, bench.yaml and plan.yaml; return the two last."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "scene.yaml").write_text(SCENE.format(side=side_px, pitch_um=11.0 * 2016 / side_px))
    tree = yaml.safe_load((EXAMPLES / "bench-by-hand.yaml").read_text())
    tree["scene"] = "scene.yaml"
    tree["simulation"].update(camera_transport="memory", samples=1, **simulation)
    (folder / "bench.yaml").write_text(yaml.safe_dump(tree, sort_keys=False))
    (folder / "plan.yaml").write_text(plan)
    return folder / "bench.yaml", folder / "plan.yaml"


def write_hand_flow(folder, pairs, more=""):
    """The bench with a laser and a double-frame camera, and the plan of a flow; return both."""
    bench, plan = write_hand_bench(folder)
    beside, _ = write_flow(folder / "motors", channels=DIODES)
    motors, tree = (yaml.safe_load(path.read_text()) for path in (beside, bench))
    tree.update(camera=motors["camera"], devices=motors["devices"])
    tree["simulation"]["row_time_us"] = 2.0
    bench.write_text(yaml.safe_dump(tree, sort_keys=False))
    flow = PLAN.replace("target_z_mm: -30.0", "target_z_mm: -20.0")
    plan.write_text(f"{flow}pairs: {pairs}\nchunk: {pairs}\ndt_us: 100.0\n{more}")
    return bench, plan


def write_real_hand_bench(folder):
    """The same without a simulation: its camera reads files, and whoever sits at the terminal turns."""
    bench, plan = write_hand_bench(folder)
    tree = yaml.safe_load(bench.read_text())
    del tree["simulation"]
    settings = {"TriggerMode": "On", "TriggerSource": "Software"}
    frames = write_frames(folder / "frames_in", 4)
    tree["camera"] = {
        "backend": "files",
        "options": {"folder": str(frames)},
        "settings": settings,
        "timeout_s": 5.0,
    }
    for axis in tree["stages"]["axes"].values():
        axis["offset_mm"] = 0.0
    bench.write_text(yaml.safe_dump(tree, sort_keys=False))
    return bench, plan
