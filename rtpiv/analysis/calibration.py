"""Summary of a calibration: its numbers, Table 2 before and after, parameters that the frames leave open."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from correction.evaluate.target_error import (
    RegionErrors,
    TargetError,
    aligned,
    computed_against_acquired,
    corrected_against_grid,
)
from correction.fit.judge.result import SceneFit
from correction.fit.judge.weakness import Weakness, weaknesses
from correction.fit.seen.measurement import TargetFrame
from correction.fit.solve.unknowns import unit_of
from correction.fitted.map_sigma import MapSigma
from correction.maps.corrector import Corrector
from rtpiv.analysis.digits import two_digits
from rtpiv.analysis.gaps import Gaps, share_of_scene
from rtpiv.analysis.through_glass import ThroughGlass

HARMLESS_PX = 0.05  # of the map, at the median: correlated numbers move nothing that vectors would show
Layers = tuple[tuple[str, str], ...]  # name and data address
Draw = Callable[[NDArray[Any], NDArray[np.float32], Corrector], Layers]
Panel = tuple[str, NDArray[np.float64], NDArray[np.float64]]  # title, pixels (N, 2), errors (N, 2) [px]


@dataclass(frozen=True)
class Calibration:
    """A fit with all that was found out about it.

    Parameters
    ----------
    fit : SceneFit
    sigma : MapSigma
        Of its map.
    senses : dict
        Scene name -> computer-generated minus acquired, by region.
    grids : dict
        Scene name -> corrected frame against the regular grid.
    panels : list
        The first sense, to be drawn.
    weak : list of Weakness
        What the frames left open.
    seconds : float
        The fit took.
    layers : tuple of (str, str)
        Name and data address of pictures of the frame through glass, as acquired and corrected; empty without a
        frame at z = 0.
    """

    fit: SceneFit
    sigma: MapSigma
    senses: dict[str, list[RegionErrors]]
    grids: dict[str, TargetError]
    panels: list[Panel]
    weak: list[Weakness]
    seconds: float
    layers: Layers = ()

    @property
    def numbers(self) -> dict[str, dict[str, Any]]:
        """Free numbers in the units of files (mm, deg, px): value, sigma, sigma before, how far it moved."""
        fit, found = self.fit, dict[str, dict[str, Any]]()
        rows = zip(fit.names, fit.values, fit.sigmas, fit.unknowns.sigma, fit.x, strict=True)
        for name, value, sigma, prior, x in rows:
            unit, factor = unit_of(name)
            found[name] = {
                "unit": unit,
                "value": float(value) * factor,
                "sigma": float(sigma) * factor,
                "prior_sigma": float(prior) * factor,
                "moved": float(x * prior) * factor,
            }
        return found

    @cached_property
    def through(self) -> Gaps | ThroughGlass | None:
        """Share of the gaps that is lit and seen in the sheet of a bed, else of what balls hide of the plane."""
        return share_of_scene(self.fit.measured_scene)

    @property
    def percentiles(self) -> dict[str, dict[str, float]]:
        """Median and largest standard deviation of the map per region, worse axis."""
        worst = self.sigma.sigma_px.max(axis=-1)
        regions = {"seen directly": ~self.sigma.behind_glass, "behind glass": self.sigma.behind_glass}
        return {
            name: {"median": float(np.median(values)), "largest": float(values.max())}
            for name, region in regions.items()
            if len(values := worst[region & np.isfinite(worst)])
        }

    @property
    def account(self) -> dict[str, dict[str, int]]:
        """Counts of corners by region: measured = used + rejected; behind glass also all visible."""
        fit, found = self.fit, dict[str, dict[str, int]]()
        for name, behind in (("seen directly", False), ("behind glass", True)):
            here = fit.corners.behind == behind
            measured, used = int(np.count_nonzero(here)), int(np.count_nonzero(here & fit.corners.inlier))
            found[name] = {"measured": measured, "used": used, "rejected": measured - used}
        found["behind glass"]["visible"] = fit.corners_expected
        return found

    def weakness_sentence(self, weakness: Weakness) -> str:
        """Describe a weakness of the fit, and whether it matters for the map."""
        worth_px = max((values["median"] for values in self.percentiles.values()), default=float("inf"))
        if weakness.together and worth_px < HARMLESS_PX:
            return f"at most {two_digits(worth_px)} px in the map: {weakness.sentence}"
        return f"not determined: {weakness.sentence}"

    def costs_nothing(self, weakness: Weakness) -> bool:
        """Return whether a weakness of fitted parameters is in the map's sigma, and that is small everywhere."""
        largest_px = max((values["largest"] for values in self.percentiles.values()), default=float("inf"))
        is_of_numbers = weakness.together or "known no better than before" in weakness.sentence
        return is_of_numbers and bool(weakness.names) and largest_px < HARMLESS_PX

    @property
    def harmless_said(self) -> str:
        """Sentence with the number of weaknesses that cost the map nothing; "" if none."""
        count = sum(self.costs_nothing(weakness) for weakness in self.weak)
        if not count:
            return ""
        largest_px = max(values["largest"] for values in self.percentiles.values())
        what = "group of numbers is" if count == 1 else "groups of numbers are"
        return (
            f"{count} {what} strongly correlated, or known no better than before: that is in the sigma of the map,"
            f" which is {two_digits(largest_px)} px at most"
        )

    def to_dict(self) -> dict[str, Any]:
        """Everything a later reader needs, JSON-able."""
        fit, corners = self.fit, self.fit.corners
        return {
            "scene_hash": fit.measured_scene.content_hash(),
            "nominal_hash": fit.unknowns.scene.content_hash(),
            "wavelength_nm": fit.scene.wavelength_nm,
            "frames": list(fit.frames),
            "seconds": round(self.seconds, 2),
            "numbers": self.numbers,
            "rms_px": {
                name: corners.rms_px(behind).tolist()
                for name, behind in (("seen directly", False), ("behind glass", True))
                if np.any(corners.inlier & (corners.behind == behind))
            },
            "visible_behind_glass": fit.corners_expected,
            "used_behind_glass": fit.corners_paired,
            "outliers": int(np.count_nonzero(~corners.inlier)),
            "corners": self.account,
            "through_glass": None if self.through is None else self.through.share,
            "model": fit.verdict.to_dict(),
            "refused": fit.refused,
            "overlap_removed_mm": fit.pushed_mm,
            "map_sigma_px": self.percentiles,
            "weak": [weakness.sentence for weakness in self.weak],
            "table2_computed_minus_acquired_px": {
                name: [
                    {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in asdict(r).items()}
                    for r in regions
                ]
                for name, regions in self.senses.items()
            },
            "table2_corrected_minus_grid_px": {name: error.to_dict() for name, error in self.grids.items()},
            "history": [str(step) for step in fit.history],
        }


def calibration_of(
    fit: SceneFit, sigma: MapSigma, frames: Sequence[TargetFrame], seconds: float, draw: Draw | None = None
) -> Calibration:
    """Compare nominal and fitted glass in both senses of Table 2, on the frame through glass at z = 0.

    `draw` makes pictures of this frame as acquired and as the fitted scene corrects it.
    """
    senses: dict[str, list[RegionErrors]] = {}
    grids: dict[str, TargetError] = {}
    panels: list[Panel] = []
    layers: Layers = ()
    for frame in [frame for frame in frames if frame.glass and not (frame.pose or frame.height_mm)][:1]:
        number = fit.frames.index(frame.name)
        scenes = {"nominal glass": aligned(fit), "fitted": fit.scene}
        errors, (corrected, corrector) = corrected_against_grid([*scenes.values()], frame.image, fit.board)
        grids = dict(zip(scenes, errors, strict=True))
        layers = () if draw is None else draw(frame.image, corrected, corrector)
        for name, scene in scenes.items():
            senses[name], pixel, error = computed_against_acquired(scene, fit.corners, number, fit.board)
            panels.append((f"{name}, computer-generated minus acquired", pixel, error))
    return Calibration(fit, sigma, senses, grids, panels, weaknesses(fit), seconds, layers)
