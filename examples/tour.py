"""A tour in forty lines: a scene, its maps, a corrected frame, one ray, and the fit that finds the true geometry.

    python tour.py [FOLDER]

Run it line by line in a notebook, then put your own scene file and your own frames in place of the simulated ones.
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt

import correction
import sim
import tracer


def tour(folder: Path, size_px: int = 672) -> None:
    """Look through two glass balls; pictures land in `folder`."""
    # What you believe of your bench: camera, glass, wavelength.  Lengths in mm; the camera looks at z = 0.
    scene = tracer.load_scene(Path(__file__).with_name("two_spheres_500.yaml"))

    # What your camera brings home.  Here it is simulated: everything is a few tenths of a millimetre off the file.
    frames = sim.make_frames(scene, size_px, 1, folder / "frames", samples=2, stack=False)
    scene = frames.nominal  # the same scene on a sensor of `size_px`
    bare, glass = frames.frame("target_clear"), frames.frame("target_glass")  # (H, W) uint16

    # The fit: two frames of the chessboard, without and with the glass, say where everything really is.
    views = [correction.TargetFrame("bare", bare, glass=False), correction.TargetFrame("glass", glass, glass=True)]
    fit = correction.fit_scene(scene, views, correction.Chessboard())
    for name, value, sigma in zip(fit.names, fit.values, fit.sigmas, strict=True):
        print(f"{name:24} {value:10.4f} +- {sigma:.4f}")

    # Where each pixel looks (ray map), where each point of the plane is seen (correction map), and a frame as if
    # the glass were not there.
    ray_map = tracer.build_ray_map(fit.scene)
    corrector = correction.Corrector(correction.build_correction_map(fit.scene, ray_map))
    corrected = corrector(glass)  # (H, W) float32; NaN where nothing can be recovered
    print(f"{corrector.recovered.mean():.0%} of the plane is recovered")

    # One ray: pinhole, where it enters and leaves each ball, where it meets the plane.
    path_mm = tracer.ray_path(fit.scene, (0.55 * size_px, 0.5 * size_px))

    figure, (seen, flat, x_map, side) = plt.subplots(1, 4, figsize=(16.0, 4.0), layout="constrained")
    for axes, picture, title in ((seen, glass, "acquired"), (flat, corrected, "corrected")):
        axes.imshow(picture, cmap="gray")
        axes.set_title(title)
    figure.colorbar(
        x_map.imshow(ray_map.plane_mm[..., 0], vmin=-80.0, vmax=80.0), label="x [mm] that a pixel looks at"
    )
    x_map.set_title("ray map")
    side.plot(path_mm[1:, 0], path_mm[1:, 2], "o-")
    side.set(title="one ray", xlabel="x [mm]", ylabel="z [mm]")
    figure.savefig(folder / "tour.png")


if __name__ == "__main__":
    tour(Path(sys.argv[1] if len(sys.argv) > 1 else "tour"))
