"""Two runs of one flow, focused apart, become one mean: beside the glass from the one, behind it from the other.

Where no aperture is small enough (`rtpiv focus`), the flow is measured twice: with the lens sharp on the plane,
and sharp on the image of the plane behind the glass.  Means need no two moments to be the same, only the flow.  A
vector is taken by where it is seen: directly, from the first run; behind glass, from the second; on a rim, where a
window joins both, from the one whose mean is surer.  Nothing is averaged across the runs, so every vector has one
origin, and `source` says which.

Both runs see the whole plane, one of them blurred.  Where both have a mean their difference over its sigma says
whether they saw the same flow: its root mean square is 1 if nothing but chance is between them.
"""

from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from correction.evaluate.regions import Region, regions_of
from daq.runs.lab_readings import merge_readings, readings_attribute
from ground.short_repr import short_repr
from piv.errors import SeriesError
from piv.statistics.denoised_mean import DenoisedMean
from piv.statistics.effective_samples import EffectiveSamples
from piv.statistics.moments import Moments
from rtpiv.analysis.series.mean_flow import MeanFlow, image_field, too_few_of
from rtpiv.analysis.series.series_folder import MEAN
from rtpiv.analysis.series.series_mean import mean_of_series, mean_vectors, write_statistics
from rtpiv.analysis.series.series_view import SeriesView

BESIDE, BEHIND = 1, 2  # values of `source`; 0 where there is no mean
Floats = NDArray[np.float64]


@short_repr
@dataclass(frozen=True, eq=False)
class JoinedMean:
    """One mean of two runs.

    Parameters
    ----------
    mean : MeanFlow
        The statistics.
    source : (ny, nx) uint8
        0 none, 1 from the run focused beside the glass, 2 from the one focused behind it.
    apart_in_sigma : float
        Root mean square of the difference of both means over its sigma, where both are known.
    """

    mean: MeanFlow
    source: NDArray[np.uint8]
    apart_in_sigma: float


def join_series(beside: Path, behind: Path, out: Path) -> JoinedMean:
    """Join the means of two series and write mean.nc into `out`.

    Parameters
    ----------
    beside, behind : Path
        Folders of the series that were focused beside the glass, and behind it.
    out : Path
        Folder for the joined mean.

    Raises
    ------
    SeriesError
        Both are one series, one has no glass, they lie on different grids, or one of them is damaged.
    RunUnsuitable, ConfigError, DiskError
        As `mean_of_series`.
    """
    first_view, view = SeriesView(beside), SeriesView(behind)
    views = {"beside": first_view, "behind": view}
    if first_view.about["keys"] == view.about["keys"]:
        raise SeriesError(
            f"{beside} and {behind} are the same vectors; give the run that was focused on the plane and the"
            " one focused behind the glass"
        )
    for each in views.values():
        if not each.about["glass"]:
            raise SeriesError(f"{each.folder}: was seen without glass; both runs have to look through it")
    first, second = mean_of_series(first_view), mean_of_series(view)
    known = image_field(second.mean_m_s, second.sigma_m_s, second.px_per_m_s, view.windows)
    region = regions_of(known, view.correction.corrector.map, view.scene).region[::-1]
    joined = join_means(first, second, region)
    about: dict[str, Any] = {
        "run": " and ".join(each.about["run"] for each in views.values()),
        "scene_hash": view.scene.content_hash(),
        "rtpiv_version": version("rtpiv"),
    }
    for name, each in views.items():
        about[f"{name}_run"] = each.about["run"]
        about[f"{name}_scene_hash"] = each.scene.content_hash()
        about |= readings_attribute(each.about.get("readings", {}), name)
    about |= readings_attribute(merge_readings(each.about.get("readings", {}) for each in views.values()))
    source = {"source": (joined.source.astype(np.int8), "1")}
    write_statistics(out / MEAN, mean_vectors(joined.mean, about, source))
    return joined


def join_means(first: MeanFlow, second: MeanFlow, region: NDArray[np.uint8]) -> JoinedMean:
    """Join two means on one grid by the region (ny, nx) of their vectors, rows from the lowest y.

    Raises
    ------
    SeriesError
        They lie on different grids.
    """
    same = np.array_equal(first.x_mm, second.x_mm) and np.array_equal(first.y_mm, second.y_mm)
    if not same or first.window_px != second.window_px:
        raise SeriesError(
            "the two series lie on different grids; evaluate both with the same windows, and with scenes that have"
            " the camera at the same place"
        )
    has_first, has_second = first.count > 1, second.count > 1
    unsure = [np.nan_to_num(np.square(each.sigma_m_s).sum(axis=-1), nan=np.inf) for each in (first, second)]
    # On a rim both are blurred: the less unsure run counts there.
    behind = (region == Region.GLASS) | ((region == Region.RIM) & (unsure[1] < unsure[0]))
    source = np.where(behind & has_second, BEHIND, np.where(~behind & has_first, BESIDE, 0)).astype(np.uint8)
    moments, denoised = _moments_by_source(source, first.moments, second.moments), None
    if first.denoised is not None and second.denoised is not None:
        denoised = DenoisedMean(
            _moments_by_source(source, first.denoised.unfiltered, second.denoised.unfiltered),
            first.denoised.filter,
            *(
                _by_source(source, getattr(first.denoised, name), getattr(second.denoised, name))
                for name in ("mean", "noise", "taken")
            ),
        )
    samples = np.where((source == BEHIND)[..., None], second.effective.samples, first.effective.samples)
    both = first.effective, second.effective
    way = " and ".join(dict.fromkeys(each.way for each in both))
    effective = EffectiveSamples(samples, way, all(each.converged for each in both))
    left_out = [(f"beside: {tag}", why) for tag, why in first.left_out]
    left_out += [(f"behind: {tag}", why) for tag, why in second.left_out]
    mean = replace(
        first,
        moments=moments,
        denoised=denoised,
        effective=effective,
        used=first.used + second.used,
        usual_share=min(first.usual_share, second.usual_share),
        resolution_m_s=_by_source(source, first.resolution_m_s, second.resolution_m_s),
        stress_resolution_m2_s2=_by_source(source, first.stress_resolution_m2_s2, second.stress_resolution_m2_s2),
        dt_sigma_share=float(np.hypot(first.dt_sigma_share, second.dt_sigma_share) / np.sqrt(2.0)),
        left_out=tuple(left_out),
        map_sigma_m_s=None,
        map_sigma_position_mm=None,
        no_map_sigma="of two runs: see their own means",
        too_few=too_few_of((first, second), source == 0),
        slope=None
        if first.slope is None or second.slope is None
        else _by_source(source, first.slope, second.slope),
    )
    return JoinedMean(mean, source, _rms_in_sigma(first, second))


def _moments_by_source(source: NDArray[np.uint8], beside: Moments, behind: Moments) -> Moments:
    """Moments from the run that gave the mean of a place."""
    there = behind.to_arrays()
    arrays = {
        name: np.where(_fit(source == BEHIND, here), there[name], here)
        for name, here in beside.to_arrays().items()
    }
    return Moments.from_arrays(arrays).only(source != 0)


def _fit(mask: NDArray[np.bool_], values: NDArray[Any]) -> NDArray[np.bool_]:
    """A mask (ny, nx) with the axes of an array (ny, nx, ...)."""
    return mask.reshape(mask.shape + (1,) * (values.ndim - 2))


def _by_source(source: NDArray[np.uint8], beside: Floats, behind: Floats) -> Floats:
    """Each value from the run that gave the mean there; NaN where none did."""
    chosen = np.where(_fit(source == BEHIND, behind), behind, beside)
    return np.where(_fit(source == 0, chosen), np.nan, chosen)


def _rms_in_sigma(first: MeanFlow, second: MeanFlow) -> float:
    """Root mean square of the difference over its sigma; NaN where no vector has both."""
    with np.errstate(invalid="ignore", divide="ignore"):
        off = (first.mean_m_s - second.mean_m_s) / np.hypot(first.sigma_m_s, second.sigma_m_s)
    off = off[np.isfinite(off)]
    return float(np.sqrt(np.mean(np.square(off)))) if off.size else float("nan")
