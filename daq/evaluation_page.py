"""The page of an evaluated pair: pictures, vectors, errors by region, both routes, provenance."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from correction.corrector import Corrector
from correction.evaluate.image_figures import image_figures
from correction.evaluate.regions import Regions
from correction.evaluate.shift import ShiftResult, shift_errors
from correction.evaluate.vector_field import VectorField
from correction.evaluate.velocity_route import PlaneVectors
from correction.node_status import MEANING, NodeStatus
from daq.pictures.vectors import histogram_figure, ring_figure, vector_figure
from daq.report import Page, grey, tinted
from tracer.scene import Scene

FULL_SCALE = {1: 255.0, 2: 4095.0, 4: 4095.0}  # by bytes a pixel; 12-bit cameras deliver uint16
SHIFT_HEAD = ("region", "vectors", "bias u, v", "std u, v", "estimated sigma u, v")
_ROUTE_HEAD = ("r / R", "image route rms [px]", "velocity route rms [px]", "better")


@dataclass(frozen=True)
class Evaluation:
    """Result of one pair.

    Parameters
    ----------
    field : VectorField
        Vectors on the corrected image (the image route).
    regions : Regions
        Where each belongs.
    shift : ShiftResult or None
        Errors, if the true displacement is known.
    plane_vectors : PlaneVectors or None
        Vectors of the velocity route, if asked for.
    """

    field: VectorField
    regions: Regions
    shift: ShiftResult | None
    plane_vectors: PlaneVectors | None


def write_page(
    out: Path,
    evaluation: Evaluation,
    corrector: Corrector,
    scene: Scene,
    frames: tuple[NDArray[Any], NDArray[np.float32]],
    about: dict[str, str],
) -> None:
    """Write report.html and its figures.

    Parameters
    ----------
    out : Path
        Folder.
    evaluation : Evaluation
        What was found.
    corrector : Corrector
        How the frames were corrected.
    scene : Scene
        The scene.
    frames : (ndarray, ndarray)
        Frame A as acquired and as corrected.
    about : dict of str to str
        Provenance.
    """
    field, result = evaluation.field, evaluation.shift
    page = Page("PIV through glass: " + about["frames"])
    raw, corrected = frames
    limits = (float(np.percentile(raw, 1)), float(np.percentile(raw, 99.7)))
    page.heading("Raw and corrected")
    if raw.shape == corrected.shape:
        left, right = tinted(grey(raw, limits), np.ones(raw.shape, bool)), grey(corrected, limits)
        caption = "Frame A as acquired, and corrected; slate blue cannot be recovered. Drag the handle."
        page.slider(left, tinted(right, corrector.recovered), ("corrected", "acquired")[::-1], caption)
    page.table(("nodes", "share"), _mask_rows(corrector))
    page.heading("Vectors")
    if result is None:
        colour = np.hypot(field.u_px, field.v_px)
        drawing = vector_figure(field, colour, "displacement [px]", "displacement, every second vector")
    else:
        colour = np.linalg.norm(shift_errors(field, result.shift_px), axis=-1)
        drawing = vector_figure(field, colour, "error [px]", "displacement, every second vector, error in colour")
    _figure(page, out, "vectors", drawing, "Vectors on the corrected image.")
    page.table(("vectors", "count"), [(name, str(count)) for name, count in field.counts.items()])
    if result is not None:
        page.heading("Errors against the known shift [px]")
        page.table(SHIFT_HEAD, shift_rows(result))
        page.text(
            f"True shift {result.shift_px[0]:.4f}, {result.shift_px[1]:.4f} px (v down). The stage's own standard "
            f"error is {result.stage_px:.3f} px a frame: a common bias of that size is not the optics' fault."
        )
        if result.rings:
            _figure(page, out, "rings", ring_figure(result), "Behind the glass, image route.")
    if evaluation.plane_vectors is not None and result is not None:
        page.heading("Velocity route")
        page.table(
            ("r / R", "image route rms", "velocity route rms", "better"), _route_rows(evaluation, corrector, scene)
        )
    page.heading("Images")
    names = {"acquired": (raw, None), "corrected": (corrected, corrector.recovered)}
    full = FULL_SCALE[raw.dtype.itemsize]
    figures = {name: image_figures(image, full, mask) for name, (image, mask) in names.items()}
    rows = [
        (
            name,
            f"{f.particles_per_px:.4f}",
            f"{f.diameter_u_px:.2f}, {f.diameter_v_px:.2f}",
            f"{f.signal_to_noise:.1f}",
            f"{100 * f.saturated:.3f} %",
        )
        for name, f in figures.items()
    ]
    page.table(("frame", "particles per px", "diameter u, v [px]", "signal to noise", "saturated"), rows)
    counts = {name: (f.edges, f.histogram.astype(np.float64)) for name, f in figures.items()}
    _figure(page, out, "histogram", histogram_figure(counts, "grey level"), "Intensity of frame A.")
    page.heading("Provenance")
    page.table(("", ""), [*about.items(), ("bodies", ", ".join(body.name for body in scene.bodies))])
    page.write(out / "report.html")


def _figure(page: Page, out: Path, name: str, drawing: bytes, caption: str) -> None:
    (out / f"{name}.svg").write_bytes(drawing)
    page.svg(drawing, caption)


def _mask_rows(corrector: Corrector) -> list[tuple[str, str]]:
    counts = np.bincount(corrector.status.ravel(), minlength=len(NodeStatus))
    total = corrector.status.size
    return [(text, f"{100 * counts[status] / total:.2f} %") for status, text in MEANING.items() if counts[status]]


def shift_rows(result: ShiftResult) -> list[tuple[str, ...]]:
    """Table rows under SHIFT_HEAD."""
    return [
        (
            name,
            str(found.count),
            f"{found.bias_px[0]:+.4f}, {found.bias_px[1]:+.4f}",
            f"{found.std_px[0]:.4f}, {found.std_px[1]:.4f}",
            f"{found.sigma_px[0]:.4f}, {found.sigma_px[1]:.4f}",
        )
        for name, found in result.regions.items()
    ]


def _route_rows(evaluation: Evaluation, corrector: Corrector, scene: Scene) -> list[tuple[str, ...]]:
    """Rms error of both routes by ring, and which is better."""
    result, traced = evaluation.shift, evaluation.plane_vectors
    assert result is not None
    assert traced is not None
    pitch = corrector.map.grid.pitch_mm
    errors = traced.shift_mm / pitch - np.array([result.shift_px[0], -result.shift_px[1]])
    radius = np.full(len(errors), np.nan)
    cmap = corrector.map
    spheres = {sphere.name: sphere for sphere in scene.spheres}
    for number in np.unique(traced.branch[traced.branch > 0]):
        last = spheres[cmap.branches[int(number)][-1]]
        here = traced.branch == number
        radius[here] = np.linalg.norm(traced.place_mm[here] - last.centre_mm[:2], axis=1) / last.radius_mm
    rows: list[tuple[str, ...]] = []
    for (low, high), image in result.rings.items():
        inside = (radius >= low) & (radius < high)
        one = float(np.sqrt(np.mean(np.square(image.std_px) + np.square(image.bias_px))))
        two = float(np.sqrt((errors[inside] ** 2).mean())) if inside.any() else float("inf")
        better = "image" if one <= two else "velocity"
        rows.append((f"{low:.3f} to {high:.3f}", f"{one:.4f}", f"{two:.4f}" if inside.any() else "none", better))
    return rows
