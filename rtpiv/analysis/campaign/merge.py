"""All runs of a campaign together: an index of chunks, and one file of statistics.

Pairs of a run are merged by the tree over their numbers (`piv.statistics.merge_tree`), runs by the tree over
theirs, so that neither workers nor the order in which chunks came show in any bit.  Memory holds one chunk, one
mean a run and some log2 of sums.

**What more runs make surer.** Runs are independent, so their effective samples add up.  What is the same in all
pairs of a run does not average out for certain: its resolution, its dt and its map may err alike in all of them,
so for these the mean of their squares, weighted by pairs, is kept.  Whether the runs saw one flow is asked: the
differences of their means from that of all, over their sigma, are 1 in rms if only chance is between them.
"""

import csv
import io
import json
import shlex
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from importlib.metadata import version
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from daq.atomic_write import write_text
from daq.errors import Unfinished
from daq.runs.lab_readings import merge_readings, readings_attribute
from daq.runs.names import camera_of
from ground.plain_words import quantity
from ground.short_repr import short_repr
from piv.errors import SeriesError
from piv.statistics.denoised_mean import DenoisedMean
from piv.statistics.effective_samples import EffectiveSamples, mean_sigma
from piv.statistics.merge_tree import merge_in_order
from piv.statistics.moments import Moments
from rtpiv.analysis.campaign.campaign_folder import CampaignFolder, RunStatus, campaign_status
from rtpiv.analysis.series.mean_flow import MeanFlow, too_few_of
from rtpiv.analysis.series.series_folder import marker_of
from rtpiv.analysis.series.series_mean import mean_of_series, mean_vectors, write_mean, write_statistics
from rtpiv.analysis.series.series_plan import chunk_path
from rtpiv.analysis.series.series_view import SeriesView

STATISTICS, INDEX = "campaign.nc", "index.csv"
HEAD = ("run", "chunk", "pairs", "without_vectors", "file", "bytes", "sha256", "key")
Floats = NDArray[np.float64]


@short_repr
@dataclass(frozen=True, eq=False)
class CampaignMean:
    """Statistics of all runs.

    Parameters
    ----------
    mean : MeanFlow
        Of all pairs.
    apart : dict of str to float
        Of each run: its mean off that of all, over the sigma of that difference, root mean square over places; NaN
        of a single run.
    cameras : dict of str to CampaignMean
        The same of each other camera, by its name.
    """

    mean: MeanFlow
    apart: dict[str, float]
    cameras: dict[str, "CampaignMean"] = field(default_factory=dict)


def merge_campaign(folder: CampaignFolder) -> CampaignMean:
    """Average every run, then all of each camera; write mean.nc into each series, and campaign.nc and index.csv.

    Runs of further cameras are averaged among themselves, into campaign-NAME.nc.

    Raises
    ------
    Unfinished
        Chunks are missing.
    SeriesError
        A chunk is not what was written, no pair has a vector, or runs lie on different grids.
    RunUnsuitable, ConfigError, DiskError
        As `rtpiv.analysis.series.series_mean.mean_of_series`.
    """
    states = campaign_status(folder)
    require_finished(folder, states)
    names = [state.name for state in states]
    views = [SeriesView(folder.series(name).path) for name in names]
    means = [mean_of_series(view) for view in views]
    for view, mean in zip(views, means, strict=True):
        write_mean(view, mean)
    write_index(folder)
    by_camera = dict[str, list[int]]()
    for number, run in enumerate(folder.about["runs"]):
        by_camera.setdefault(camera_of(Path(run["path"])), []).append(number)
    parts = dict[str, CampaignMean]()
    for camera, chosen in by_camera.items():
        runs = [(names[number], views[number], means[number]) for number in chosen]
        parts[camera] = _merge_runs(folder.path / (statistics_of(camera) if parts else STATISTICS), runs)
    first, *others = parts
    return replace(parts[first], cameras={camera: parts[camera] for camera in others})


def _merge_runs(file: Path, runs: Sequence[tuple[str, SeriesView, MeanFlow]]) -> CampaignMean:
    """Average the runs of a camera and write their statistics."""
    names, views, means = zip(*runs, strict=True)
    merged = merge_means(names, means)
    scenes = [view.about["content"]["correction"] for view in views]
    about = {"runs": " ".join(names), "corrections": " ".join(scenes), "rtpiv_version": version("rtpiv")}
    about["runs_apart_in_sigma"] = " ".join(f"{merged.apart[name]:.3f}" for name in names)
    apart = {
        name: view.about["readings"] for name, view in zip(names, views, strict=True) if "readings" in view.about
    }
    about |= readings_attribute(merge_readings(apart.values()))
    if apart:
        about["readings_of_runs"] = json.dumps(apart)
    write_statistics(file, mean_vectors(merged.mean, about))
    return merged


def statistics_of(camera: str) -> str:
    """Return the name of the file of statistics of another camera than the first."""
    return f"campaign-{camera}.nc"


def _run_again(folder: CampaignFolder) -> str:
    """Return the command that evaluates what is missing."""
    return f"give: rtpiv campaign run -o {shlex.quote(str(folder.path))}"


def require_finished(folder: CampaignFolder, states: Sequence[RunStatus]) -> None:
    """Raise Unfinished if chunks are missing."""
    if missing := sum(state.chunks - state.done for state in states):
        text = f"{quantity(missing, 'chunk')} {'is' if missing == 1 else 'are'} missing"
        raise Unfinished(text, place=folder.path, cure=_run_again(folder))


def write_index(folder: CampaignFolder) -> None:
    """Write index.csv: every chunk of every run in order, by its marker."""
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(HEAD)
    for asked in folder.about["runs"]:
        series = folder.series(asked["name"])
        for number, key in enumerate(series.about["keys"]):
            path = chunk_path(series.path, number)
            marker = marker_of(path, key)
            if marker is None:
                raise Unfinished("is gone again", place=path, cure=_run_again(folder))
            file = path.relative_to(folder.path).as_posix()
            row = (marker.pairs, len(marker.failed), file, marker.size, marker.sha256, key)
            table.writerow((asked["name"], number, *row))
    write_text(folder.path / INDEX, text.getvalue())


def merge_means(names: Sequence[str], means: Sequence[MeanFlow]) -> CampaignMean:
    """Statistics of several runs as those of one.

    Raises
    ------
    SeriesError
        They lie on different grids.
    """
    first = means[0]
    for name, mean in zip(names, means, strict=True):
        same = np.array_equal(mean.x_mm, first.x_mm) and np.array_equal(mean.y_mm, first.y_mm)
        if not same or mean.window_px != first.window_px:
            raise SeriesError(
                f"the vectors of {name} lie on another grid than those of {names[0]}, and cannot be averaged with"
                " them; the means of single runs are there"
            )
    if len(means) == 1:
        return CampaignMean(first, {names[0]: float("nan")})
    # Sums of moments are exact; what only bounds an error is averaged by squares, with the pairs of each place.
    moments = merge_in_order(enumerate(mean.moments for mean in means))
    denoised, parts = None, [mean.denoised for mean in means if mean.denoised is not None]
    if len(parts) == len(means):
        unfiltered = merge_in_order(enumerate(part.unfiltered for part in parts))
        denoised = DenoisedMean.of(unfiltered, moments, parts[0].filter)
    weights = np.stack([mean.count for mean in means]).astype(np.float64)
    samples = np.nansum([mean.effective.samples for mean in means], axis=0)
    ways = " and ".join(dict.fromkeys(mean.effective.way for mean in means))
    # Runs are independent of each other, so their effective samples add.
    several = moments.count[..., None] > 1
    effective = EffectiveSamples(
        np.where(several, np.maximum(samples, 1.0), np.nan), ways, all(m.effective.converged for m in means)
    )
    used = np.array([mean.used for mean in means], float)
    has_maps = all(mean.map_sigma_m_s is not None for mean in means)
    nothing = next((mean.no_map_sigma for mean in means if mean.map_sigma_m_s is None), "")
    merged = replace(
        first,
        dt_s=float(np.average([mean.dt_s for mean in means], weights=used)),
        moments=moments,
        denoised=denoised,
        effective=effective,
        used=int(used.sum()),
        usual_share=min(mean.usual_share for mean in means),
        resolution_m_s=_rms([mean.resolution_m_s for mean in means], weights),
        stress_resolution_m2_s2=_rms([mean.stress_resolution_m2_s2 for mean in means], weights),
        dt_sigma_share=float(np.sqrt(np.average([mean.dt_sigma_share**2 for mean in means], weights=used))),
        left_out=tuple((f"{n}: {tag}", why) for n, m in zip(names, means, strict=True) for tag, why in m.left_out),
        map_sigma_m_s=_rms([mean.map_sigma_m_s for mean in means], weights) if has_maps else None,
        map_sigma_position_mm=_rms([mean.map_sigma_position_mm for mean in means], weights) if has_maps else None,
        no_map_sigma=nothing,
        too_few=too_few_of(means, moments.count == 0),
        slope=_slope([mean.slope for mean in means], weights),
    )
    return CampaignMean(
        merged, {name: _rms_in_sigma(mean, merged.moments) for name, mean in zip(names, means, strict=True)}
    )


def _rms(parts: Sequence[Floats | None], weights: Floats) -> Floats:
    """Root of the weighted mean of squares (ny, nx, ...); NaN where no part is known."""
    values = np.stack([part for part in parts if part is not None])
    weight = weights.reshape(weights.shape + (1,) * (values.ndim - weights.ndim))
    weight = np.where(np.isfinite(values), weight, 0.0)
    total = weight.sum(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        found: Floats = np.sqrt((weight * np.nan_to_num(values) ** 2).sum(axis=0) / total)
    return found


def _slope(parts: Sequence[Floats | None], weights: Floats) -> Floats | None:
    """Slopes (ny, nx, 2) of the rays of several runs: their weighted mean; None where one does not know them."""
    known = [part for part in parts if part is not None]
    if len(known) < len(parts):
        return None
    values = np.stack(known)
    weight = np.where(np.isfinite(values), weights[..., None], 0.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        found: Floats = (weight * np.nan_to_num(values)).sum(axis=0) / weight.sum(axis=0)
    return found


def _rms_in_sigma(run: MeanFlow, everything: Moments) -> float:
    """Rms of the difference of a run's mean from that of all, over its sigma, which shares the run's own part."""
    others = 1.0 - run.count / np.maximum(everything.count, 1)
    with np.errstate(invalid="ignore", divide="ignore"):
        sigma = mean_sigma(run.moments, run.effective) * np.sqrt(others)[..., None]
        off = (run.moments.mean_uv - everything.mean_uv) / sigma
    off = off[np.isfinite(off)]
    return float(np.sqrt(np.mean(np.square(off)))) if off.size else float("nan")
