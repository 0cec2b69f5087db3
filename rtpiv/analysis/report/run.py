"""The chapters of a run: table of pairs, displacements of the target, frame account, gauges, provenance."""

from collections.abc import Mapping, Sequence
from datetime import datetime
from math import nan

from daq.runs.displacement import FILE as MOVED
from daq.runs.displacement import read_displacements
from daq.runs.done_file import read_done
from daq.runs.frame_accounting import FrameAccounting, chunk_sentences, rejection_sentence
from daq.runs.journal_lines import ReadingRecord
from daq.runs.lab_readings import reading_statistics
from daq.runs.run_folder import RunFolder
from daq.runs.run_views import notes_of, readings_of
from rtpiv.analysis.pairs.evaluation import Evaluation
from rtpiv.analysis.pictures.plane_axes import SOFT, Figure
from rtpiv.analysis.report.figures import SERIES
from rtpiv.analysis.report.page import Link, Page
from rtpiv.analysis.report.table import MAX_ROWS, Table
from rtpiv.analysis.report.tables import DIRECT, GLASS, totals_of

PAIR_COLUMNS = (
    "pair",
    "valid vectors",
    "behind glass",
    "known shift x, y [mm]",
    "total error beside glass u, v [px]",
    "total error behind glass u, v [px]",
)


def pairs_chapter(page: Page, found: Sequence[Evaluation]) -> None:
    """Every pair of a run in one line; the pages of the single pairs lie in folders of their names."""
    page.heading("Pairs of this run")
    rows: list[tuple[str | Link, ...]] = []
    for evaluation in found[:MAX_ROWS]:
        result, task = evaluation.shift, evaluation.task
        totals = {total.region: total for total in totals_of(evaluation)}
        cells = ["-", "-", "-"]
        if result is not None and task.shift_mm is not None:
            cells = ["{:+.4f}, {:+.4f}".format(*task.shift_mm)]
            known = (totals.get(region) for region in (DIRECT, GLASS))
            cells += ["-" if total is None else "{:.4f}, {:.4f}".format(*total.total_px) for total in known]
        behind = str(totals[GLASS].count) if GLASS in totals else "0"
        name = Link(task.name, f"{task.out.name}/report.html")
        rows.append((name, str(evaluation.field.counts["valid"]), behind, *cells))
    more = f"; {len(found) - MAX_ROWS} more are in their folders" if len(found) > MAX_ROWS else ""
    page.table(Table(f"Total error: bias and scatter, rms{more}", PAIR_COLUMNS, rows))
    for note in dict.fromkeys(evaluation.task.note for evaluation in found if evaluation.task.note):
        about = ", ".join(evaluation.task.name for evaluation in found if evaluation.task.note == note)
        page.text(f"{about}: {note}")


def account_chapter(page: Page, folder: RunFolder) -> None:
    """Add the account of every frame."""
    page.heading("Frame account")
    chunks = chunk_sentences(folder.entries())
    for sentence in chunks:
        page.text(f"{sentence[:1].upper()}{sentence[1:]}.")
    done = read_done(folder)
    if done is None:
        page.text("The run is not finished: resume it, or what follows is a part of the plan.")
        return
    account = FrameAccounting.from_dict(done["conservation"])
    said = account.sentence()
    said = said.replace("rejected", "dark or surplus") if chunks else said
    page.text(said + ("." if account.imbalance == 0 else f", out by {account.imbalance}."))
    if said := rejection_sentence(folder.entries()):
        page.text(f"{said[:1].upper()}{said[1:]}.")
    counts = [(name, str(count)) for name, count in account.to_dict().items()]
    page.table(Table("", ("frames", "count"), counts))
    rows: list[tuple[str, ...]] = []
    for flow in done["flow"]:
        latency = flow["latency_ms"]
        times = ("-", "-") if latency is None else (f"{latency['p50']:.0f}", f"{latency['p99']:.0f}")
        rows.append((str(len(rows) + 1), str(flow["corrected_live"]), str(flow["skipped_live"]), *times))
    if rows:
        columns = ("session", "corrected live", "corrected after", "latency p50 [ms]", "p99 [ms]")
        page.table(Table("", columns, rows))


def displacement_chapter(page: Page, folder: RunFolder) -> None:
    """Add commanded, measured and (simulated bench only) true displacements."""
    if not (folder.path / MOVED).is_file():
        return
    moved = read_displacements(folder)
    by_hand = any("sigma_mm" in entry for entry in moved)
    page.heading("Displacements of the target")
    rows = [
        (
            entry["tag"],
            *(
                "-" if moved_mm is None else ", ".join(f"{c:+.4f}" for c in moved_mm)
                for moved_mm in (entry["commanded_mm"], entry["measured_mm"], entry["true_mm"])
            ),
            *(
                (", ".join("-" if c is None else f"{c:.4f}" for c in entry.get("sigma_mm", ())),)
                if by_hand
                else ()
            ),
        )
        for entry in moved[:MAX_ROWS]
    ]
    head: tuple[str, ...] = ("step", "commanded x, y, z [mm]", "measured", "true (simulation)")
    head += ("sigma of measured, as read by hand",) if by_hand else ()
    page.table(Table("Displacement of the target. Errors above are against the measured one.", head, rows))


def notes_chapter(page: Page, folder: RunFolder) -> None:
    """Add the operator's notes from the plan; nothing where there are none."""
    if notes := notes_of(folder):
        page.heading("Operator's notes")
        page.facts(list(notes.items()))


def provenance_chapter(page: Page, folder: RunFolder, scene_hash: str, rows: list[tuple[str, str]]) -> None:
    """Add files, scenes and versions that made these figures."""
    about = folder.about
    notes_chapter(page, folder)
    readings_chapter(page, folder)
    page.heading("Provenance")
    hashes = [(f"hash of the {name}", str(value)) for name, value in about["hashes"].items() if value]
    facts = [("run", folder.path.name), ("plan", str(about["name"])), *rows]
    facts += [("hash of the scene used here", scene_hash), *hashes]
    facts += [(name, str(version)) for name, version in about["versions"].items()]
    page.facts(facts)
    steps = about["steps"]
    more = f", the first {MAX_ROWS} of {len(steps)}" if len(steps) > MAX_ROWS else ""
    rows_of_steps = [
        (str(s["index"]), str(s["tag"]), str(s["view"]), str(s["first_frame"]), str(s["frames"]))
        for s in steps[:MAX_ROWS]
    ]
    page.table(Table(f"Steps of the plan{more}", ("step", "tag", "view", "first frame", "frames"), rows_of_steps))
    for name in ("plan", "bench", "scene"):
        page.details(f"{name}.yaml as it was when the run began", str(about[name]))


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
