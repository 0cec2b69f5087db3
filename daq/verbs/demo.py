"""`rtpiv demo`: look through simulated glass, from frames to velocity vectors, without any hardware."""

import json
from importlib import import_module
from pathlib import Path

from daq.terminal import console
from daq.verbs.calibrate import calibrate
from daq.verbs.correct import correct
from daq.verbs.evaluate import evaluate
from daq.verbs.trace import trace

SCENE = "two_spheres_500"
SIZE_PX = 1008
SEED = 7


def demo(out: Path) -> None:
    """Render frames through two misaligned balls, find the true geometry, correct, and measure a known shift.

    Parameters
    ----------
    out : Path
        Folder: ``frames/`` as a camera would give them, ``trace/`` what the scene shows, ``nominal/`` corrected
        with what the experimenter knows, ``calibrated/`` the scene found from the frames, ``fitted/`` corrected
        with it, ``shift/`` vectors and report of the printed particles.
    """
    screen = console()
    make_frames = import_module("sim.demo_frames").make_frames  # by name: nothing below sim imports it
    screen.rule("1  a camera looks through two glass balls")
    with screen.status("rendering frames with an independent renderer"):
        frames = make_frames(SCENE, SIZE_PX, SEED, out / "frames", stack=False)
    nominal, fitted = out / "frames" / "scene.yaml", out / "calibrated" / "scene.yaml"
    glass = frames.path("target_glass")
    screen.rule("2  what the scene shows")
    trace(nominal, out / "trace")
    screen.rule("3  corrected as known: everything is a few tenths of a millimetre off")
    correct([glass], nominal, out / "nominal", frames.path("target_clear"), check_target=True)
    screen.rule("4  the true geometry, found from the target frames")
    calibrate(out / "frames", nominal, out / "calibrated")
    screen.rule("5  corrected with the geometry found")
    correct([glass], fitted, out / "fitted", check_target=True)
    screen.rule("6  a particle sheet moved by 14 px, measured through the glass")
    pair = [frames.path("particles_glass_a"), frames.path("particles_glass_b")]
    shift_mm = json.loads((out / "frames" / "frames.json").read_text(encoding="utf-8"))["shift_mm"]
    evaluate(pair, out / "shift", fitted, shift_mm=(shift_mm[0], shift_mm[1]), velocity=True)
    screen.print(
        f"[bold]Look at {out / 'shift' / 'report.html'}, {out / 'fitted' / 'overview.png'} "
        f"and {out / 'trace' / 'fig4_markers.png'}[/bold]"
    )
