"""The chapter that asks particles seen twice whether the spheres stand where they were calibrated."""

from correction.errors import SheetError
from correction.self_check.moved_sphere import FALSE_ALARMS, SelfCheck
from piv.errors import PairError
from rtpiv.analysis.light_sheet import flow_frames
from rtpiv.analysis.report.page import Page
from rtpiv.analysis.self_check import self_check_of
from rtpiv.analysis.series.series_input import SCENE_FILE, SeriesInput
from tracer.scene.scene_file import load_scene

HEAD = ("sphere", "move x, y, z [um]", "sigma [um]", "by chance", "explains")


def self_check_chapter(page: Page, series: SeriesInput) -> None:
    """Add the chapter, where a run shows particles behind glass in enough pairs."""
    try:
        found = self_check_of(flow_frames([series.run], load_scene(series.out / SCENE_FILE)))
    except (PairError, SheetError):
        return
    show_self_check(page, found)


def show_self_check(page: Page, found: SelfCheck) -> None:
    """Show what was found."""
    page.heading("Do the spheres stand where they were calibrated?")
    if found.moved:
        page.warning(found.sentence)
    else:
        page.text(found.sentence + ".")
    rows = [
        (
            one.name,
            ", ".join(f"{1e3 * mm:+.0f}" for mm in one.move_mm) if one.is_told else "not determined",
            ", ".join(f"{1e3 * mm:.0f}" for mm in one.sigma_mm),
            f"{one.probability:.1g}",
            f"{one.explains:.0f}",
        )
        for one in found.moves
    ]
    if rows:
        said = (
            "Each sphere by itself as the one that moved; the one that explains most of what is apart is named."
            f" Spheres that stand still raise an alarm in fewer than {FALSE_ALARMS:g} of all checks"
        )
        page.table(HEAD, rows, said)
