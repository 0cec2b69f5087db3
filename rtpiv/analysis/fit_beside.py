"""Uncertainty of a scene: the fit beside its file, if there is one."""

from pathlib import Path

from correction.fitted.scene_sigma import SceneSigma
from ground.errors import GroundError
from tracer.errors import TracerError
from tracer.scene.scene import Scene

SCENE_FILE, FIT_FILE = "scene.yaml", "fit.npz"  # beside each other, of a fit as in the folder of a series


def scene_sigma_beside(
    scene: Path, fitted: Scene, dewarped: bool, *, in_light_sheet: bool = True
) -> SceneSigma | str:
    """Uncertainty of the scene from the fit beside its file, or why there is none.

    Parameters
    ----------
    scene : Path
        Scene file.
    fitted : Scene
        As loaded from it.
    dewarped : bool
        Whether a dewarp stands in for the camera's lens terms, of which the fit knows nothing.
    in_light_sheet : bool
        Whether particles are looked at, which lie in the scene's light sheet, and not the target.
    """
    if not scene.with_name(FIT_FILE).is_file():
        from daq.runs.run_views import tells_a_scale_alone

        if tells_a_scale_alone(fitted):
            return "nothing is known of the camera"
        return "there is no fit beside the scene; run rtpiv calibrate"
    if dewarped:
        return "the fit does not hold for a dewarped camera"
    try:
        sigma = SceneSigma.load(scene.with_name(FIT_FILE))
        sigma.check(fitted)
    except (GroundError, TracerError) as error:
        return str(error)
    return sigma.in_light_sheet(fitted) if in_light_sheet else sigma
