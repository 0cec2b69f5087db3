"""`rtpiv mean --at`: velocity over time at points and along a line, with spectra."""

from collections.abc import Sequence
from pathlib import Path

from daq.errors import RunUsageError
from ground.plain_words import quantity
from ground.terminal import console
from rtpiv.analysis.series.time_series import FILE, TimeSeries, time_series
from rtpiv.verbs.paths import Named
from rtpiv.verbs.results import results_in

PAGE = "time_series.html"


def timeseries(
    series: Named,
    /,
    at: Sequence[float] = (),
    line: tuple[float, float, float, float] | None = None,
    out: Named | None = None,
) -> TimeSeries:
    """Write velocities over time at points of the plane.

    Parameters
    ----------
    series : path
        Folder of a series (see `evaluate`).
    at : sequence of float
        x and y of each point [mm]: ``--at 0 10 -5 20`` are two points.
    line : (float, float, float, float), optional
        x and y of both ends of a line [mm].
    out : path, optional
        Folder, default ``timeseries`` (or ``timeseries-2`` ... where that has results), for ``time_series.nc`` and
        the page ``time_series.html``.

    Returns
    -------
    TimeSeries
        Velocities, their uncertainty, and the spectrum if the pairs are evenly timed.

    Raises
    ------
    RunUsageError
        No place is named, half of one, or one beyond the vectors.
    RunUnsuitable, SeriesError
        The folder is no series, or is damaged.
    DiskError
        The folder cannot hold the results.
    """
    if len(at) % 2 or not (len(at) or line is not None):
        raise RunUsageError("give x and y of each point in mm, as in --at 0 10 -5 20, or both ends of a --line")
    places = list(zip(at[::2], at[1::2], strict=True))
    with results_in(out, "timeseries") as out:
        found = time_series(Path(series), places, None if line is None else (line[:2], line[2:]))
        found.write(out / FILE)
        from rtpiv.analysis.report.time_series import time_series_page  # draws

        time_series_page(found, found.run).write(out / PAGE)
        screen = console()
        said = f"{quantity(len(found.time), 'pair')} at {quantity(len(found.place_mm), 'place')}"
        screen.print(said if found.spectrum is not None else f"{said}; no spectrum: {found.why_none}")
        screen.print(f"look at {out / PAGE}", soft_wrap=True)
        return found
