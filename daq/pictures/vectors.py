"""A vector field with its errors in colour: Figs. 7 and 8 of Martins et al. (2018)."""

import io

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from correction.evaluate.shift import ShiftResult
from correction.evaluate.vector_field import VectorField

EVERY = 2  # vectors drawn along each axis


def vector_figure(field: VectorField, colour: NDArray[np.float64], label: str, title: str) -> bytes:
    """Draw every second vector, coloured, as SVG.

    Parameters
    ----------
    field : VectorField
        Vectors on the corrected image.
    colour : (ny, nx) float64
        Value behind each vector; NaN is left out.
    label, title : str
        Said at the colour bar and on top.
    """
    figure = Figure(figsize=(8.0, 7.2), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    known = colour[np.isfinite(colour)]
    limit = float(np.percentile(known, 99)) if len(known) else 1.0
    extent = (field.x_px[0], field.x_px[-1], field.y_px[-1], field.y_px[0])
    image = axes.imshow(colour, extent=extent, cmap="viridis", vmin=0.0, vmax=limit, interpolation="nearest")
    image.set_rasterized(True)
    some = (slice(None, None, EVERY), slice(None, None, EVERY))
    drawn = field.valid[some]
    x, y = np.meshgrid(field.x_px[::EVERY], field.y_px[::EVERY])
    arrows = axes.quiver(
        x[drawn],
        y[drawn],
        field.u_px[some][drawn],
        -field.v_px[some][drawn],
        color="white",
        width=0.0012,
        scale_units="xy",
        angles="uv",
        scale=0.6,
    )
    arrows.set_rasterized(True)
    axes.set(title=title, xlabel="u [px]", ylabel="v [px]", aspect="equal")
    figure.colorbar(image, ax=axes, label=label, shrink=0.8)
    return _svg(figure)


def ring_figure(result: ShiftResult) -> bytes:
    """Draw scatter and bias behind the glass against r / R, as SVG."""
    figure = Figure(figsize=(7.0, 3.6), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    radius = [0.5 * (low + high) for low, high in result.rings]
    std = np.array([scatter.std_px for scatter in result.rings.values()]).reshape(-1, 2)
    bias = np.array([scatter.bias_px for scatter in result.rings.values()]).reshape(-1, 2)
    sigma = np.array([scatter.sigma_px for scatter in result.rings.values()]).reshape(-1, 2)
    axes.plot(radius, np.sqrt((std**2).mean(axis=1)), "o-", label="scatter")
    axes.plot(radius, np.sqrt((sigma**2).mean(axis=1)), "s--", label="estimated sigma")
    axes.plot(radius, np.abs(bias).max(axis=1), "^:", label="largest bias")
    axes.set(xlabel="r / R", ylabel="px", ylim=(0.0, None), title="behind the glass, by radius")
    axes.legend()
    return _svg(figure)


def histogram_figure(counts: dict[str, tuple[NDArray[np.float64], NDArray[np.float64]]], label: str) -> bytes:
    """Draw histograms (edges, counts) by name on a logarithmic axis, as SVG."""
    figure = Figure(figsize=(7.0, 3.2), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    for name, (edges, values) in counts.items():
        axes.stairs(values, edges, label=name)
    axes.set(yscale="log", xlabel=label, ylabel="pixels")
    axes.legend()
    return _svg(figure)


def _svg(figure: Figure) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="svg", dpi=110, metadata={"Date": None})
    return buffer.getvalue()
