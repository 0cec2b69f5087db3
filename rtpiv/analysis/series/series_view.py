"""Scene, grid, windows and uncertainty of the fit of a series, read from its folder."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from correction.fitted.prepared import PreparedCorrection, prepare
from correction.fitted.scene_sigma import SceneSigma
from correction.grid import PlaneGrid, grid_of
from correction.maps.correction_map import MAX_LAYERS
from daq.runs.glass_place import with_glass_at
from daq.runs.lab_readings import readings_attribute
from piv.correlation.settings import PivSettings, settings_of
from piv.correlation.windows import WindowGrid
from piv.errors import PairError, SeriesError
from piv.statistics.out_of_plane import OutOfPlane
from rtpiv.analysis.fit_beside import SCENE_FILE, scene_sigma_beside
from rtpiv.analysis.series.series_folder import SeriesFile, SeriesFolder
from tracer.scene.scene import Scene
from tracer.scene.scene_file import load_scene


@dataclass(frozen=True)
class SeriesView:
    """The view of a series; each part is read when it is first asked for, and once.

    Parameters
    ----------
    folder : Path
        Of the series.
    given_out_of_plane : OutOfPlane, optional
        Knowledge of the out-of-plane velocity, in place of that of the evaluation of its pairs.

    Raises
    ------
    RunUnsuitable
        The folder is no series, when anything is asked for.
    SeriesError
        Its file is damaged, or does not say how its pairs were evaluated.
    ConfigError
        Its scene cannot be read.
    """

    folder: Path
    given_out_of_plane: OutOfPlane | None = None

    @cached_property
    def about(self) -> SeriesFile:
        """Contents of series.json."""
        return SeriesFolder(self.folder).about

    @cached_property
    def readings(self) -> dict[str, Any]:
        """Readings of gauges over the steps of its pairs, as an attribute of its mean."""
        return readings_attribute(self.about.get("readings", {}))

    @cached_property
    def file_scene(self) -> Scene:
        """The scene as its file says it."""
        return load_scene(self.folder / SCENE_FILE)

    @cached_property
    def standing(self) -> Scene:
        """The scene with the glass where it stood, and the light sheet where it is."""
        if not self.about["glass"]:
            return self.file_scene.bare()
        return with_glass_at(self.file_scene, self.about["glass_place_mm"])

    @cached_property
    def scene(self) -> Scene:
        """The same as particles in its light sheet are seen."""
        return self.standing.in_light_sheet()

    @cached_property
    def sigma(self) -> SceneSigma | str:
        """Uncertainty of the fit of its scene, for particles in its light sheet; or why that is not known."""
        file, dewarped = self.folder / SCENE_FILE, self.about["dewarped"]
        sigma = scene_sigma_beside(file, self.file_scene, dewarped, in_light_sheet=False)
        return sigma if isinstance(sigma, str) else sigma.in_light_sheet(self.standing)

    @cached_property
    def grid(self) -> PlaneGrid:
        """Nodes of its corrected frames."""
        said = self.about["content"].get("grid")
        if said is None:
            return grid_of(self.scene.camera)
        try:
            (x_mm, y_mm), (rows, columns) = said["origin_mm"], said["shape"]
            return PlaneGrid((float(x_mm), float(y_mm)), float(said["pitch_mm"]), (int(rows), int(columns)))
        except (KeyError, TypeError, ValueError):
            raise self._says_too_little() from None

    @property
    def view(self) -> int:
        """View of places that its camera sees on several paths: 0 the best, 1 the second best alone."""
        number = self.about["content"].get("view", 0)
        return number if isinstance(number, int) and 0 <= number < MAX_LAYERS else 0

    @cached_property
    def settings(self) -> PivSettings:
        """Settings of the correlation of its pairs."""
        content: dict[str, Any] = self.about["content"]
        try:
            return settings_of(content["settings"])
        except (KeyError, IndexError, TypeError, PairError):
            raise self._says_too_little() from None

    @cached_property
    def out_of_plane(self) -> OutOfPlane:
        """Knowledge of the out-of-plane velocity: as given now, or when its pairs were evaluated."""
        if self.given_out_of_plane is not None:
            return self.given_out_of_plane
        try:
            return OutOfPlane(**self.about["content"].get("out_of_plane", {}))
        except (TypeError, PairError):
            raise self._says_too_little() from None

    @cached_property
    def windows(self) -> WindowGrid:
        """Windows of its vectors on the corrected image."""
        return self.settings.result_grid(self.grid.shape)

    @cached_property
    def correction(self) -> PreparedCorrection:
        """Correction of its frames, without a limit of sigma; its map is made or loaded."""
        return prepare(self.scene, maps=self.folder / "maps", grid=self.grid, view=self.view)

    def _says_too_little(self) -> SeriesError:
        return SeriesError(
            f"{self.folder}: series.json does not say how its pairs were evaluated; evaluate the run again"
        )
