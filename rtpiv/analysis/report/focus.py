"""The page of a focus scan: width of spots at every place, where each part is sharp, what eq. 1 asks for."""

from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from rtpiv.analysis.focus import FocusScan
from rtpiv.analysis.report.page import Page
from rtpiv.analysis.report.table import Table

if TYPE_CHECKING:
    from rtpiv.analysis.pictures.plane_axes import Figure


def focus_table(scan: FocusScan) -> Table:
    """Best focus of each part."""
    rows = [
        (each.part, each.why, "", "")
        if each.why
        else (each.part, f"{each.z_mm:+.1f}", f"{each.sigma_mm:.1f}", f"{each.diameter_px:.1f}")
        for each in scan.best
    ]
    columns = ("part", "sharp at [mm]", "sigma [mm]", "spot there [px]")
    return Table(f"Best place of the {scan.moves}, from its place in the scene", columns, rows)


def focus_sentence(scan: FocusScan) -> str:
    """Return the conclusion in one or two sentences."""
    has = f"at f/{scan.f_number:g} the depth of field by eq. 1 is {scan.depth_mm:.1f} mm"
    if not np.isfinite(scan.needed_mm):
        return (
            f"{has}; this scan does not say whether the scene needs more: fewer than two parts have a best place."
        )
    needs = f"the scene needs {scan.needed_mm:.1f} +- {scan.needed_sigma_mm:.1f} mm"
    if scan.needed_mm <= scan.depth_mm:
        return f"{has}, and {needs}: it is enough."
    return (
        f"{has}, but {needs}: close the lens to f/{scan.needed_f_number:.1f} or more, or take two focus settings."
    )


def write_focus_page(path: Path, name: str, scan: FocusScan) -> None:
    """Write the page of a scan; `name` is the run's."""
    page = Page(f"{name}: focus through glass", f"{len(scan.z_mm)} places of the {scan.moves}")
    known = np.isfinite(scan.needed_mm)
    page.tiles(
        [
            (
                f"{scan.needed_mm:.1f} mm" if known else "-",
                "depth that the scene needs",
                f"+- {scan.needed_sigma_mm:.1f} mm" if known else "too few parts are sharp in this scan",
            ),
            (f"{scan.depth_mm:.1f} mm", f"depth at f/{scan.f_number:g}", f"M = {scan.magnification:.3f}, eq. 1"),
            (
                f"f/{scan.needed_f_number:.1f}" if known else "-",
                "asked for by eq. 1",
                f"{scan.wavelength_nm:g} nm",
            ),
        ]
    )
    page.text(focus_sentence(scan))
    page.table(focus_table(scan))
    page.figure(
        "focus", _figure(scan), "Width of spots (e^-2) in each part; points are measured, lines mark the best."
    )
    page.facts([("run", name), ("moves", scan.moves), ("rtpiv", version("rtpiv"))])
    page.write(path)


def _figure(scan: FocusScan) -> "Figure":
    from rtpiv.analysis.pictures.plane_axes import Figure

    figure = Figure(figsize=(7.2, 4.2), layout="constrained")
    axes = figure.add_subplot()
    for number, each in enumerate(scan.best):
        colour = f"C{number % 10}"
        width = 4.0 * np.sqrt(scan.variance_px2[each.part])
        axes.plot(scan.z_mm, width, "o-", color=colour, markersize=3, linewidth=0.7, label=each.part)
        if not each.why:
            axes.axvline(each.z_mm, color=colour, linewidth=0.8)
    axes.set(xlabel=f"place of the {scan.moves} [mm]", ylabel="spot diameter [px]")
    axes.set_ylim(bottom=0.0)
    axes.legend(fontsize=8)
    return figure
