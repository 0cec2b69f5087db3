"""What a run leaves, as small as it can be: facts of a frame, run.json for some steps, lines of a journal."""

import json

from daq.runs.raw_frame import checksum, write_raw

BENCH = """name: bench
scene: scene.yaml
stages:
  controllers: {box: {driver: zaber_ascii, port: /dev/box}}
  axes:
    target_x: {controller: box, channel: 1/1, carries: target, along: x, limits_mm: [-9.0, 9.0], speed_mm_s: 1.0,
               acceleration_mm_s2: 1.0}
  home_order: [target_x]
camera: {backend: files}
"""
PLACES = {"planned_mm": {"target_x": 1.0}, "measured_mm": {"target_x": 1.001}}
FLOW = {"corrected_live": 0, "skipped_live": 0, "latency_ms": None}


def planned(index, tag="step", view="glass", shows="particles", frames=1, reference=None, first_frame=None):
    """A step as run.json has it."""
    first = index * frames if first_frame is None else first_frame
    return {"index": index, "tag": tag, "first_frame": first, "frames": frames, "view": view, "shows": shows,
            "on_plane": True, "reference": reference}  # fmt: skip


def about_run(steps, **more):
    """What run.json says beside its layout."""
    asked = {"bench": "bench.yaml", "plan": "plan.yaml", "simulate": True, "correct": False, "scene": None,
             "target_clear": None, "dewarp_order": 2, "method": "quintic", "live_queue": 4}  # fmt: skip
    texts = {"plan": "experiment: stream\n", "bench": BENCH, "scene": "camera: {}\n"}
    return {"name": "small", "request": asked, "hashes": {"plan": "p"}, "versions": {"python": "3"}, **texts,
            "square_mm": 2.5, "steps": list(steps), **more}  # fmt: skip


def frame_facts(pixels, step=0, tag="step", **more):
    """What the journal and the file say about a frame."""
    return {"step": step, "tag": tag, "crc32": checksum(pixels), "frame_id": 1, "sequence": 0, "timestamp_ns": 5,
            "received_ns": 6, "exposure_us": 100.0, "bits": 12, **PLACES,
            "sensor_px": list(pixels.shape[::-1]), **more}  # fmt: skip


def keep_frame(folder, journal, number, pixels, **facts):
    """Write a frame and its line, as the raw thread does."""
    known = frame_facts(pixels, **facts)
    write_raw(folder.frame_path(number), pixels, known)
    journal.append("frame", frame=number, file=f"frames/{number:06d}.tif", **known)


def keep_step(journal, step, tag="step", **more):
    """Write the line of a finished step."""
    journal.append("step", step=step, tag=tag, utc="2026-01-01T00:00:00.000+00:00", **PLACES, **more)


def make_old(folder):
    """Turn a run into one of layout 1."""
    for name in ("run.json", "done.json"):
        tree = json.loads((folder.path / name).read_text())
        tree.pop("seal")
        tree.pop("sha256", None)
        (folder.path / name).write_text(json.dumps(tree | ({"layout": 1} if name == "run.json" else {}), indent=1))
    lines = [json.loads(line) for line in folder.journal_path.read_text().splitlines()]
    moved = json.loads((folder.path / "displacements.json").read_text())
    for entry in (*lines, *moved):
        entry.pop("seal")
    folder.journal_path.write_text("".join(json.dumps(line) + "\n" for line in lines))
    (folder.path / "displacements.json").write_text(json.dumps(moved, indent=1))
