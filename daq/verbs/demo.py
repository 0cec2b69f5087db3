"""`rtpiv demo`: look through simulated glass, from frames to pictures, without any hardware."""

from importlib import import_module
from pathlib import Path

from daq.terminal import console
from daq.verbs.correct import correct
from daq.verbs.trace import trace

SCENE = "two_spheres_500"
SIZE_PX = 1008
SEED = 7


def demo(out: Path) -> None:
    """Render frames through two hidden-misaligned balls and correct them.

    Parameters
    ----------
    out : Path
        Folder: ``frames/`` as a camera would give them, ``trace/``, ``nominal/`` corrected with what the
        experimenter knows, ``true/`` corrected with the true scene, which nobody at a bench knows.
    """
    screen = console()
    make_frames = import_module("sim.demo_frames").make_frames  # by name: nothing below sim imports it
    screen.rule("a camera looks through two glass balls")
    with screen.status("rendering frames with an independent renderer"):
        frames = make_frames(SCENE, SIZE_PX, SEED, out / "frames", stack=False)
    screen.rule("what the scene shows")
    trace(out / "frames" / "scene.yaml", out / "trace")
    glass = [frames.path("target_glass"), frames.path("particles_glass_a"), frames.path("particles_glass_b")]
    for title, scene, target in (
        (
            "corrected with the scene as known: everything is a few tenths of a millimetre off",
            "scene",
            "target_clear",
        ),
        ("corrected with the true scene", "truth", None),
    ):
        screen.rule(title)
        folder = out / {"scene": "nominal", "truth": "true"}[scene]
        clear = frames.path(target) if target else None
        correct(glass[:1], out / "frames" / f"{scene}.yaml", folder, clear, check_target=True)
        correct(glass[1:], out / "frames" / f"{scene}.yaml", folder / "particles", clear)
    screen.print(f"[bold]Look at {out / 'true' / 'overview.png'} and {out / 'trace' / 'fig4_markers.png'}[/bold]")
