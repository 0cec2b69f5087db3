"""Printing of results; the code that computes them prints nothing."""

from collections.abc import Collection, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from rich.console import Console

from ground.plain_words import quantity
from rtpiv.analysis.report.table import Table

if TYPE_CHECKING:  # printing a calibration must not import the evaluation of a series
    from rtpiv.analysis.calibration import Calibration
    from rtpiv.analysis.campaign.campaign_folder import RunStatus
    from rtpiv.analysis.campaign.campaign_plan import Forecast
    from rtpiv.analysis.gaps import Gaps
    from rtpiv.analysis.pairs.evaluation import Evaluation
    from rtpiv.analysis.series.mean_flow import MeanFlow
    from rtpiv.analysis.series.run_series import Evaluated
    from rtpiv.analysis.through_glass import ThroughGlass
    from tracer.scene.scene import Scene

HIGHEST = 0.99  # of all speeds of a mean: a few outliers are no flow
SHOWN_REASONS = 10  # pairs that are named one by one


def show_through(screen: Console, scene: "Scene") -> None:
    """Print the share seen through glass, or inside a bed that of the gaps which is lit and seen."""
    from rtpiv.analysis.gaps import share_of_scene

    if (shown := share_of_scene(scene)) is not None:
        screen.print(shown.sentence, style="bold")


def say_through(screen: Console, shown: "ThroughGlass | Gaps | None", scene: "Scene") -> None:
    """Print the share seen through glass, with advice where it is little; inside a bed that of the gaps."""
    from rtpiv.analysis.views.arranged import little

    if shown is None:
        return
    screen.print(shown.sentence, style="bold")
    if advice := little(scene, shown):
        screen.print(advice, style="bold red")


def show_evaluation(screen: Console, evaluation: "Evaluation", page: bool) -> None:
    """Print the result of a pair, and the path of its page."""
    from rtpiv.analysis.report import tables
    from rtpiv.analysis.report.sigma_verdict import claim_said, worst_claim

    if evaluation.seen is not None and evaluation.seen.through is not None:
        screen.print(evaluation.seen.through.sentence, style="bold")
    screen.print(str(evaluation))
    if evaluation.field.warning:
        screen.print(evaluation.field.warning, style="bold red")
    for warning in evaluation.scale_warnings:
        screen.print(warning, style="bold red")
    if worst := worst_claim(evaluation):
        screen.print(claim_said(*worst), style="" if worst[1].claim == "as claimed" else "bold red")
    if evaluation.no_tracks:
        screen.print(f"no tracks: {evaluation.no_tracks}", style="bold red")
    chosen = [tables.displacement_table if evaluation.shift is None else tables.shift_table]
    if evaluation.map_sigma is not None:
        chosen += [tables.sigma_table, tables.claim_table]
    if evaluation.tracks is not None:
        chosen.append(tables.track_table)
    for table in (make(evaluation) for make in chosen):
        if table.rows:
            screen.print(table)
    if page:
        screen.print(f"look at {evaluation.task.out / 'report.html'}")


def show_exclusions(screen: Console, reasons: "Sequence[tuple[str, str]]", rest: str) -> None:
    """Print why pairs are left out, once for all pairs of one reason; `rest` has what is not printed."""
    names_of: dict[str, list[str]] = {}
    for name, why in reasons:
        names_of.setdefault(why, []).append(name)
    for why, names in list(names_of.items())[:SHOWN_REASONS]:
        some = ", ".join(names[:SHOWN_REASONS]) + (", ..." if len(names) > SHOWN_REASONS else "")
        verb = "is left out" if len(names) == 1 else f"({quantity(len(names), 'pair')}) are left out"
        screen.print(f"{some} {verb}: {why}", style="bold red")
    if len(names_of) > SHOWN_REASONS:
        screen.print(f"and {len(names_of) - SHOWN_REASONS} more reasons; {rest} has them", style="bold red")


def show_series(screen: Console, done: "Evaluated") -> None:
    """Print the state of the pairs of a series."""
    before = f"; {done.kept} of them had been evaluated before" if done.kept else ""
    screen.print(done.summary + before, style="bold red" if done.has_few_valid else None)
    show_exclusions(screen, done.reasons, "the page")
    for warning in done.warnings:
        screen.print(warning, style="bold red")


def show_forecasts(screen: Console, forecasts: "Sequence[Forecast]") -> None:
    """Print the costs of a campaign."""
    rows = []
    for each in forecasts:
        costs = (each.left_s / 3600.0, each.read_bytes * 1e-9, each.write_bytes * 1e-9)
        counts = (each.pairs, each.chunks, each.done)
        rows.append((each.name, *map(str, counts), *(f"{cost:.2f}" for cost in costs)))
    columns = ("run", "pairs", "chunks", "done", "core hours left", "GB to read", "GB to write")
    screen.print(Table("campaign", columns, rows))
    for each in forecasts:
        if each.again:
            again = f"{quantity(each.again, 'finished chunk')} {'is' if each.again == 1 else 'are'} made again"
            text = f"{each.name}: {again}, as frames have changed or the run has more pairs than before"
            screen.print(text, style="bold red")


def show_campaign(screen: Console, states: "Sequence[RunStatus]") -> None:
    """Print the state of a campaign."""
    rows = [
        (
            state.name,
            *map(str, (state.chunks, state.done)),
            f"{state.done_pairs} of {state.pairs}",
            str(sum(state.without_vectors.values())),
        )
        for state in states
    ]
    screen.print(Table("campaign", ("run", "chunks", "done", "pairs done", "without vectors"), rows))
    lines = [
        f"{s.name}: {quantity(count, 'pair')}: {why}" for s in states for why, count in s.without_vectors.items()
    ]
    for line in lines[:SHOWN_REASONS]:
        screen.print(line)
    if len(lines) > SHOWN_REASONS:
        screen.print(f"and {len(lines) - SHOWN_REASONS} more in the markers of the chunks")


def show_focus(screen: Console, table: Table, sentence: str, page: Path) -> None:
    """Print where a view is sharp."""
    screen.print(table)
    screen.print(sentence)
    screen.print(f"look at {page}")


def show_mean(screen: Console, mean: "MeanFlow", page: Path | None, said: Collection[str] = ()) -> None:
    """Print a mean flow with its uncertainties, and why pairs are left out, except those already reported."""
    seen = mean.count > 0
    for each in mean.warnings:
        screen.print(each, style="bold red")
    screen.print(f"mean of {quantity(mean.used, 'pair')}; {len(mean.left_out)} are left out")
    show_exclusions(screen, [(tag, why) for tag, why in mean.left_out if tag not in said], "mean.nc")
    speed = np.where(seen, np.linalg.norm(mean.mean_m_s, axis=-1), np.nan)
    highest = float(np.nanquantile(speed, HIGHEST)) if seen.any() else 0.0
    flows = speed >= 0.5 * highest
    above = f"speed above half of {highest:.3g} {mean.unit}, {int(flows.sum())} of {int(seen.sum())} places"
    parts = [
        (f"mean [{mean.unit}]", mean.mean_m_s),
        (f"its random sigma [{mean.unit}]", mean.sigma_m_s),
        *([] if mean.unit == "px" else [("its random sigma [px]", mean.sigma_m_s * mean.px_per_m_s)]),
        (f"not resolved of it [{mean.unit}]", np.repeat(mean.resolution_m_s[..., None], 2, axis=-1)),
        (f"total sigma [{mean.unit}]", mean.total_sigma_m_s),
        (f"fluctuation, without noise [{mean.unit_squared}]", mean.stresses_m2_s2[..., :2]),
        ("effective samples", mean.effective.samples),
    ]
    if mean.slant_sigma_m_s is not None:
        parts.insert(4, (f"sigma by the flow through the sheet [{mean.unit}]", mean.slant_sigma_m_s))
    if np.isfinite(mean.dt_sigma_share):
        parts.insert(4, (f"sigma by dt, one factor [{mean.unit}]", mean.dt_sigma_m_s))
    if mean.map_sigma_m_s is not None:
        parts.insert(4, (f"sigma by the fitted map [{mean.unit}]", mean.map_sigma_m_s))
    rows = []
    for name, values in parts:
        there = [values[..., k][flows & np.isfinite(values[..., k])] for k in (0, 1)]
        rows.append((name, *(f"{np.median(each):.4g}" if each.size else "-" for each in there)))
    screen.print(Table(f"median where it flows: {above}", ("", "u", "v"), rows))
    if mean.no_map_sigma:
        screen.print(f"no map uncertainty: {mean.no_map_sigma}")
    if doubt := mean.effective.warning(mean.used):
        screen.print(doubt)
    if mean.gaps:
        screen.print(mean.gaps)
    if page is not None:
        screen.print(f"look at {page}")


def show_calibration(screen: Console, found: "Calibration", page: bool = True) -> None:
    """Print the results of a fit, and what the frames leave undetermined."""
    from rtpiv.analysis.report.calibration import calibration_lead, parameter_table

    fit = found.fit
    say_through(screen, found.through, fit.measured_scene)
    title = f"fitted scene {fit.measured_scene.content_hash()}; every other number was held fixed"
    screen.print(replace(parameter_table(found), title=title))
    screen.print(_error_table(found))
    screen.print(calibration_lead(found)[1])
    for behind, alike in fit.verdict.correlation.items():
        if alike.corners:
            region = "behind glass" if behind else "seen directly"
            screen.print(f"corners {region}: {alike.independent:.0f} effectively independent of {alike.corners}")
    for sentence in fit.verdict.sentences:
        screen.print(f"model: {sentence}", style="" if fit.verdict.is_right else "bold red")
    for weakness in found.weak:
        if not found.costs_nothing(weakness):
            screen.print(found.weakness_sentence(weakness))
    if said := found.harmless_said:
        screen.print(f"{said}; {'calibration.html' if page else 'calibration.json'} names them")


def _error_table(found: "Calibration") -> Table:
    rows: list[tuple[str, ...]] = []
    for name, regions in found.senses.items():
        for r in regions:
            bias, rms = (f"{p[0]:+.3f}, {p[1]:+.3f}" for p in (r.bias_px, r.rms_px))
            figures = (r.region, str(r.corners), bias, rms.replace("+", ""), f"{r.largest_px:.2f}")
            rows.append(("computed - acquired", name, *figures))
    rows += [
        ("corrected - grid", name, *figures) for name, error in found.grids.items() for figures in error.rows()
    ]
    columns = ("sense", "scene", "region", "corners", "bias u, v", "rms u, v", "largest")
    return Table("position error of target points [px]", columns, rows)
