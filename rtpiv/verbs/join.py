"""`rtpiv mean --join`: join the means of two runs, focused beside the glass and behind it."""

from pathlib import Path

from ground.terminal import console
from rtpiv.analysis.series.series_folder import MEAN
from rtpiv.analysis.series.split_focus import BEHIND, BESIDE, JoinedMean, join_series
from rtpiv.verbs.paths import Named
from rtpiv.verbs.results import results_in

STRANGERS = 2.0  # sigma: more, and the two runs did not see one flow, or one of them is too blurred to say
TOO_FAR_APART = (
    "that is more than chance: another flow, or a part that is too blurred to be measured in one of them"
)


def join(beside: Named, behind: Named, /, out: Named | None = None) -> JoinedMean:
    """Join two series by what each was focused on.

    Parameters
    ----------
    beside, behind : path
        Folders of series (see `evaluate`): the run focused on the plane, the one focused behind the glass.
    out : path, optional
        Folder, default ``joined`` (or ``joined-2`` ... where that has results), for the joined ``mean.nc``, in
        which `source` says where each vector comes from.

    Returns
    -------
    JoinedMean
        The statistics.

    Raises
    ------
    SeriesError, RunUnsuitable, ConfigError, DiskError
        As `rtpiv.analysis.series.split_focus.join_series`.
    """
    with results_in(out, "joined") as out:
        joined = join_series(Path(beside), Path(behind), out)
        screen = console()
        counts = {
            name: int((joined.source == value).sum()) for name, value in (("first", BESIDE), ("second", BEHIND))
        }
        screen.print(f"{counts['first']} vectors from {beside}, {counts['second']} from {behind}")
        screen.print(f"where both have a mean they differ by {joined.apart_in_sigma:.2f} sigma (rms)")
        if joined.apart_in_sigma > STRANGERS:
            screen.print(TOO_FAR_APART, style="bold red")
        screen.print(f"wrote {out / MEAN}")
        return joined
