"""What the fitted map is unsure of in the mean of a series, beside what more pairs would make surer."""

from dataclasses import replace

from correction.fitted.prepared import PreparedCorrection
from correction.fitted.scene_sigma import SceneSigma
from correction.fitted.vector_map_sigma import vector_map_sigma
from piv.correlation.windows import WindowGrid
from rtpiv.analysis.series.image_field import image_field
from rtpiv.analysis.series.mean_flow import MeanFlow


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
