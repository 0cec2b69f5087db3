"""The first line of every page: how much of what the balls hide is seen through them, and what would show more."""

from rtpiv.analysis.report.page import Page
from rtpiv.analysis.through_glass import ThroughGlass, percent
from rtpiv.analysis.views.arranged import little
from tracer.scene.scene import Scene


def through_lead(page: Page, through: ThroughGlass | None, scene: Scene, recovered: float) -> None:
    """Begin a page.

    Parameters
    ----------
    page : Page
        Grows.
    through : ThroughGlass or None
        The share; without balls before the plane there is nothing to say.
    scene : Scene
        What is asked for what would show more.
    recovered : float
        Share of the whole corrected frame that is recovered.
    """
    if through is None:
        return
    rows = [
        (f"hidden by {through.what}", f"{through.hidden_mm2:.4g} mm\u00b2"),
        ("recovered of it", f"{through.recovered_mm2:.4g} mm\u00b2"),
        ("recovered of the whole plane", percent(recovered)),
    ]
    page.lead(percent(through.share), f"{through.name} is seen through glass", ("area of the plane", ""), rows)
    if advice := little(scene, through.share):
        page.warning(advice)
