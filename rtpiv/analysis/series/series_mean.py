"""The statistics of a series from its folder to mean.nc.

What the fitted map is unsure of is added here, beside what more pairs would make surer: it needs the correction
that the frames went through.
"""

from dataclasses import replace
from importlib.metadata import version
from pathlib import Path

from correction.fitted.map_sigma import vector_map_sigma
from correction.fitted.prepared import PreparedCorrection, prepare
from correction.fitted.scene_sigma import SceneSigma
from correction.grid import PlaneGrid, grid_of
from daq.runs.glass_place import with_glass_at
from piv.correlation.windows import WindowGrid, window_grid
from piv.errors import SeriesError
from rtpiv.analysis.recipe import SCENE_FILE, scene_sigma_beside
from rtpiv.analysis.series.mean_file import mean_vectors, write_statistics
from rtpiv.analysis.series.mean_flow import MeanFlow, image_field, mean_flow
from rtpiv.analysis.series.series_folder import MEAN, Chunks, SeriesFolder
from tracer.scene.scene import Scene
from tracer.scene.scene_file import load_scene


def mean_of_series(folder: Path) -> MeanFlow:
    """Average a series; nothing is written but the maps that it needs.

    Parameters
    ----------
    folder : Path
        Of the series.

    Raises
    ------
    SeriesError
        A chunk is missing, damaged or made with other settings; or no pair has a vector.
    RunUnsuitable
        The folder is no series.
    ConfigError
        Its scene cannot be read.
    DiskError
        The file cannot be written.
    """
    mean = mean_flow(Chunks.of(folder))
    through, sigma = scene_of(folder), sigma_of(folder)
    if isinstance(sigma, str):
        mean = replace(mean, no_map_sigma=sigma)
    else:
        prepared = prepare(through, maps=folder / "maps", grid=grid_of_series(folder))
        mean = with_map_sigma(mean, prepared, windows_of(folder), sigma)
    return mean


def write_mean_of_series(folder: Path, mean: MeanFlow) -> None:
    """Write the mean.nc of a series into its folder; DiskError if that fails."""
    said = {
        "run": SeriesFolder(folder).about["run"],
        "scene_hash": scene_of(folder).content_hash(),
        "rtpiv_version": version("rtpiv"),
    }
    write_statistics(folder / MEAN, mean_vectors(mean, said))


def with_map_sigma(
    mean: MeanFlow, prepared: PreparedCorrection, windows: WindowGrid, sigma: SceneSigma
) -> MeanFlow:
    """The same statistics with the map's uncertainty of their mean.

    Parameters
    ----------
    mean : MeanFlow
        The statistics.
    prepared : PreparedCorrection
        Correction that its frames went through.
    windows : WindowGrid
        Where its vectors lie on the corrected image.
    sigma : SceneSigma
        Uncertainty of the fitted scene.
    """
    found = vector_map_sigma(
        image_field(mean.mean_m_s, mean.sigma_m_s, mean.px_per_m_s, windows),
        prepared.corrector.map,
        prepared.scene,
        sigma,
    )
    return replace(
        mean,
        map_sigma_m_s=found.displacement_px[::-1] / mean.px_per_m_s,
        map_sigma_position_mm=found.position_px[::-1] / mean.px_per_mm,
    )


def sigma_of(folder: Path) -> SceneSigma | str:
    """What the fit of its scene is unsure of, for particles in its light sheet; or why that is not known."""
    fitted, dewarped = load_scene(folder / SCENE_FILE), SeriesFolder(folder).about["dewarped"]
    sigma = scene_sigma_beside(folder / SCENE_FILE, fitted, dewarped, in_light_sheet=False)
    return sigma if isinstance(sigma, str) else sigma.in_light_sheet(standing_of(folder))


def scene_of(folder: Path) -> Scene:
    """Scene that the camera of a series looked through, as particles in its light sheet are seen."""
    return standing_of(folder).in_light_sheet()


def standing_of(folder: Path) -> Scene:
    """The same with the light sheet where it is."""
    scene, about = load_scene(folder / SCENE_FILE), SeriesFolder(folder).about
    return with_glass_at(scene, about["glass_place_mm"]) if about["glass"] else scene.bare()


def grid_of_series(folder: Path) -> PlaneGrid:
    """Nodes of its corrected frames; SeriesError if its file does not say."""
    own = grid_of(scene_of(folder).camera)
    said = SeriesFolder(folder).about["content"].get("grid")
    if said is None:
        return own
    try:
        (x_mm, y_mm), (rows, columns) = said["origin_mm"], said["shape"]
        return PlaneGrid((float(x_mm), float(y_mm)), float(said["pitch_mm"]), (int(rows), int(columns)))
    except (KeyError, TypeError, ValueError):
        raise _says_too_little(folder) from None


def _says_too_little(folder: Path) -> SeriesError:
    return SeriesError(f"{folder}: series.json does not say how its pairs were evaluated; evaluate the run again")


def windows_of(folder: Path) -> WindowGrid:
    """Where the vectors of a series lie on its corrected image; SeriesError if its file does not say."""
    content = SeriesFolder(folder).about["content"]
    try:
        side_px, overlap = int(content["settings"]["windows_px"][-1]), float(content["settings"]["overlap"])
    except (KeyError, IndexError, TypeError, ValueError):
        raise _says_too_little(folder) from None
    return window_grid(grid_of_series(folder).shape, side_px, overlap)
