"""`rtpiv trace`: what a scene shows of the plane."""

from pathlib import Path

import matplotlib.image
import numpy as np
from rich.table import Table

from correction.aperture import blur_map
from correction.correction_map import build_correction_map
from correction.node_status import MEANING, NodeStatus
from daq.analysis.pictures.blur import draw_blur
from daq.analysis.pictures.curve import draw_curve
from daq.analysis.pictures.drawing import scene_figure
from daq.analysis.pictures.markers import markers
from daq.analysis.pictures.seen import seen
from daq.terminal import console
from tracer.errors import SceneError
from tracer.fov import FieldOfView, field_of_view
from tracer.ray_map import build_ray_map
from tracer.scene_file import load_scene


def trace(scene: Path, out: Path) -> None:
    """Trace a scene; print its field of view and leave pictures.

    Parameters
    ----------
    scene : Path
        scene.yaml.
    out : Path
        Folder for ``fig4_markers.png`` (what the camera sees), ``fig5_curve.png`` (spheres in a row only)
        and ``scene.png`` (the scene from the side); ``blur.png`` if the scene says the camera's aperture.

    Raises
    ------
    ConfigError
        The scene file is wrong.
    """
    loaded = load_scene(scene)
    screen = console()
    ray_map = build_ray_map(loaded)
    correction_map = build_correction_map(loaded, ray_map)
    blur = None if loaded.camera.pupil is None else blur_map(correction_map, loaded)
    table = Table(title=f"{scene.stem}, scene {loaded.content_hash()}")
    table.add_column("", style="bold")
    table.add_column("value", justify="right")
    try:
        view: FieldOfView | None = field_of_view(loaded)
    except SceneError as error:
        view = None
        screen.print(f"no radial figures: {error}")
    if view is not None:
        for name, value in _figures(view):
            table.add_row(name, value)
    counts = np.bincount(correction_map.status.ravel(), minlength=len(NodeStatus))
    for status, meaning in MEANING.items():
        table.add_row(f"nodes {meaning}", f"{100.0 * counts[status] / correction_map.status.size:.2f} %")
    if blur is not None and np.isfinite(blur.width_px).any():
        table.add_row("blur behind glass, median", f"{np.nanmedian(blur.width_px):.2f} px")
        table.add_row("left out by the aperture", f"{100.0 * blur.left_out:.1f} % of the view behind glass")
    screen.print(table)
    out.mkdir(parents=True, exist_ok=True)
    matplotlib.image.imsave(out / "fig4_markers.png", np.clip(seen(loaded, markers()), 0.0, 1.0))
    scene_figure(loaded).savefig(out / "scene.png", dpi=120)
    if blur is not None:
        draw_blur(out / "blur.png", correction_map.grid, blur)
    if view is not None:
        draw_curve(out / "fig5_curve.png", loaded, view, scene.stem)
    screen.print(f"pictures are in {out}")


def _figures(view: FieldOfView) -> list[tuple[str, str]]:
    radius = view.radius_mm
    return [
        ("FOV_in = (r_b/R)^2", f"{100.0 * view.inside:.1f} %"),
        ("FOV_total", f"{100.0 * view.total:.1f} %"),
        ("largest recovered r_o/R", f"{view.edge_mm / radius:.3f}"),
        ("fold at r_i/R" if view.folds else "branch ends at r_i/R", f"{view.fold_mm / radius:.3f}"),
        ("silhouette r_red/R", f"{view.silhouette_mm / radius:.3f}"),
        ("r_i/r_o at the centre", f"{view.centre_magnification:+.3f}"),
        ("L/R", f"{view.distance_mm / radius:.3g}"),
    ]
