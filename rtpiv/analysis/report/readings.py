"""Readings of gauges of the lab during the run, as a chapter: over time, in all, and at each step."""

from collections.abc import Mapping, Sequence
from datetime import datetime
from math import nan

from daq.runs.journal_lines import ReadingRecord
from daq.runs.lab_readings import reading_statistics
from daq.runs.run_folder import RunFolder
from daq.runs.run_views import readings_of
from rtpiv.analysis.pictures.plane_axes import SOFT, Figure
from rtpiv.analysis.report.figures import SERIES
from rtpiv.analysis.report.page import Page
from rtpiv.analysis.report.table import MAX_ROWS, Table

SHOWN_GAUGES = 8  # drawn; the tables have all
LONG_S = 7200.0  # a longer run is drawn over hours
CAPTION = (
    "What each gauge showed at the steps, over the time since the first of them. A grey line at the bottom: a"
    " step at which it showed nothing."
)
Readings = Mapping[str, Sequence[tuple[str, ReadingRecord]]]


def readings_chapter(page: Page, folder: RunFolder) -> None:
    """Add the readings of gauges at the steps of a run; nothing where the bench has none."""
    found = readings_of(folder)
    if not found:
        return
    page.heading("Gauge readings")
    if (figure := readings_figure(found)) is not None:
        page.figure("readings", figure, CAPTION)
    over = reading_statistics({name: reading} for name, shown in found.items() for _, reading in shown)
    rows: list[tuple[str, ...]] = []
    for name, shown in found.items():
        of_it = over[name]
        values = [reading["value"] for _, reading in shown if "value" in reading]
        figures = ("-",) * 4
        if "mean" in of_it:
            spread = f"{of_it['std']:.4g}" if "std" in of_it else "-"
            figures = (f"{of_it['mean']:.6g}", spread, f"{min(values):.6g}", f"{max(values):.6g}")
        rows.append((f"{name} [{of_it['unit']}]", *figures, str(of_it["steps"]), str(of_it["missing"])))
    columns = ("reading", "mean", "standard deviation", "least", "most", "steps", "missing")
    page.table(Table("One at each step", columns, rows))
    steps: dict[str, dict[str, str]] = {}
    for name, shown in found.items():
        for tag, reading in shown:
            steps.setdefault(tag, {})[name] = (
                f"{reading['value']:.6g}" if "value" in reading else f"missing: {reading['missing']}"
            )
    title = f"The first {MAX_ROWS} of {len(steps)} steps" if len(steps) > MAX_ROWS else ""
    rows = [(tag, *(each.get(name, "-") for name in found)) for tag, each in list(steps.items())[:MAX_ROWS]]
    page.table(Table(title, ("step", *found), rows))


def readings_figure(found: Readings) -> Figure | None:
    """Draw what gauges showed over time, one axis above the other; None where none has shown two values.

    Parameters
    ----------
    found : mapping of str to sequence
        Tag and reading of each step, by the name of the gauge (`daq.runs.run_views.readings_of`).
    """
    drawn = [(name, [reading for _, reading in shown]) for name, shown in found.items()]
    drawn = [(name, each) for name, each in drawn if sum("value" in reading for reading in each) > 1]
    if not drawn:
        return None
    begins = min(_when(reading) for _, each in drawn for reading in each)
    lasts_s = max((_when(reading) - begins).total_seconds() for _, each in drawn for reading in each)
    unit, unit_s = ("h", 3600.0) if lasts_s > LONG_S else ("min", 60.0)
    drawn = drawn[:SHOWN_GAUGES]
    figure = Figure(figsize=(7.2, 0.9 + 1.5 * len(drawn)), layout="constrained")
    panels = figure.subplots(len(drawn), sharex=True, squeeze=False)[:, 0]
    for number, (axes, (name, each)) in enumerate(zip(panels, drawn, strict=True)):
        times = [(_when(reading) - begins).total_seconds() / unit_s for reading in each]
        values = [reading.get("value", nan) for reading in each]
        axes.plot(times, values, "o-", color=SERIES[number % len(SERIES)], markersize=3, linewidth=0.8)
        silent = [time for time, reading in zip(times, each, strict=True) if "value" not in reading]
        axes.vlines(silent, 0.0, 0.08, colors=SOFT, linewidth=1.0, transform=axes.get_xaxis_transform())
        axes.set_ylabel(f"{name} [{each[0]['unit']}]" if each[0]["unit"] else name)
        axes.ticklabel_format(axis="y", useOffset=False)
    panels[-1].set_xlabel(f"time since the first reading [{unit}]")
    return figure


def _when(reading: ReadingRecord) -> datetime:
    return datetime.fromisoformat(reading["utc"])
