"""Several cameras before one known flow: frames, `rtpiv mean --join`, and the errors against the flow itself.

    python -m benchmarks.views two --degrees 0 15 --pairs 200 --frames FOLDER
    python -m benchmarks.views two --judge OUT
    python -m benchmarks.views none --degrees 0 41 --pairs 20 --frames FOLDER

`two` and `three` stand 4 mm off a sheet of 1 mm, `pyramid` 3 mm, `none` has no glass.  Cameras stand on an arc
about the y axis and look at the origin.  The flow is steady waves of u and w with isotropic turbulence on top; its
sizes are given in pixels a pair.  All cameras see the same particles, each with its own noise; with `--moved` each
sees other particles and another turbulence, as one camera that was moved.

`--frames` writes a folder of TIFF pairs and a scene file for each camera.  `--judge` compares the means and the
vectors of pairs in OUT, written by the command that `--frames` prints, with the flow at the nodes.
"""

import argparse
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray

from correction.evaluate.regions import Region, regions_of
from correction.grid import grid_of
from piv.files.vector_file import Vectors, read_vectors
from rtpiv.analysis.series.mean_flow import image_field
from rtpiv.analysis.series.series_view import SeriesView
from sim.demo.scenes import at_size, demo_scene
from sim.flow.fields import Flow
from sim.flow.images import FlowCamera
from sim.flow.modes import RandomModes
from sim.flow.particles import LightSheet
from tracer.bodies import translate_by
from tracer.camera import look_at
from tracer.scene.scene import Scene
from tracer.scene.scene_file import dump_scene

Array = NDArray[Any]
SCENES = {
    "none": "two_spheres_500",
    "two": "two_spheres_500",
    "three": "three_spheres_500",
    "pyramid": "pyramid_500",
}
GAP_MM = 4.0
DT_S, RATE_HZ = 500e-6, 10.0
EDDY_MM, WAVE_MM = 30.0, 60.0
LIMIT = 0.75  # r / R of the middle of a ball


@dataclass(frozen=True)
class Waves:
    """Steady flow U = (U0 + A sin ky, V0, W sin kx cos ky), free of divergence as w does not change along z.

    Parameters
    ----------
    speed_mm_s : float
        Velocity of 1 px a pair.
    turbulence : float
        Standard deviation of each component [px].
    """

    speed_mm_s: float
    turbulence: float = 0.2

    def mean(self, points_mm: Array) -> Array:
        """U (N, 3) [mm/s]."""
        kx, ky = (2.0 * np.pi / WAVE_MM * points_mm[:, k] for k in (0, 1))
        u, v = 1.6 + 0.5 * np.sin(ky), np.full(len(points_mm), 0.8)
        return self.speed_mm_s * np.column_stack((u, v, 0.15 + 0.5 * np.sin(kx) * np.cos(ky)))

    def amplitude(self, points_mm: Array) -> Array:
        """A (N, 3, 3) [mm/s]."""
        return np.broadcast_to(self.turbulence * self.speed_mm_s * np.eye(3), (len(points_mm), 3, 3))

    def holds(self, points_mm: Array) -> Array:
        """Everywhere."""
        return np.ones(len(points_mm), np.bool_)


def scene_at(name: str, degrees: float, size_px: int, gap_mm: float = GAP_MM) -> Scene:
    """A demo scene with its camera turned about the y axis of the plane."""
    scene = at_size(demo_scene(SCENES[name]), size_px)
    distance, angle = scene.camera.position_mm[2], np.deg2rad(degrees)
    place = (float(distance * np.sin(angle)), 0.0, float(distance * np.cos(angle)))
    camera = replace(scene.camera, position_mm=place, rotation=look_at(place, (0.0, 0.0, 0.0)))
    lifted = gap_mm if name != "pyramid" else 0.0
    bodies = [body.moved(translate_by((0.0, 0.0, lifted))) for body in scene.bodies]
    return scene.with_camera(camera).with_bodies([] if name == "none" else bodies)


def flow_of(name: str, size_px: int, seed: int, turbulence: float) -> Flow:
    """The flow, its sizes in pixels of the camera straight before the plane."""
    pitch_mm = grid_of(scene_at(name, 0.0, size_px).camera).pitch_mm
    modes = RandomModes(EDDY_MM, seed=seed, shortest_mm=EDDY_MM) if turbulence else None
    return Flow(Waves(pitch_mm / DT_S, turbulence), modes)


def path_of(said: argparse.Namespace, number: int) -> Array:
    """Place (3,) of the first ball in a pair [mm], from that in the first pair: a straight drift, or a knock."""
    share = number / max(said.pairs - 1, 1) if said.knock is None else float(number >= said.knock)
    return np.asarray(share * 1e-3 * np.array(said.drift))


def cameras_of(said: argparse.Namespace, step_mm: Array) -> list[FlowCamera]:
    """Cameras before one flow, while the first ball is off its place."""
    cameras: list[FlowCamera] = []
    z_mm, along_x, along_y = said.sheet
    sheet = LightSheet(offset_mm=z_mm, slope_x=along_x, slope_y=along_y)
    for place, degrees in enumerate(said.degrees):
        other = place if said.moved else 0
        scene = scene_at(said.name, degrees, said.size)
        tilted = scene.camera.with_tilted_sensor(0.0, np.deg2rad(said.tilts[place]) if said.tilts else 0.0)
        scene = scene.with_camera(tilted)
        if step_mm.any():
            ball, *others = scene.bodies
            scene = scene.with_bodies([ball.moved(translate_by(tuple(step_mm.tolist()))), *others])
        flow = flow_of(said.name, said.size, said.seed + other, said.turbulence)
        noise = 1000 * said.seed + place
        cameras.append(
            FlowCamera(scene, flow, sheet, seed=said.seed + other, noise_seed=noise, cameras=lambda: cameras)
        )
    return cameras


def write_frames(said: argparse.Namespace) -> None:
    """Write the frames and the scene of every camera."""
    cameras = list[FlowCamera]()
    for number in range(said.pairs):
        step = path_of(said, number)
        if number == 0 or np.any(step != path_of(said, number - 1)):
            cameras = cameras_of(said, step)
        for place, camera in enumerate(cameras, start=1):
            folder = said.frames / f"camera{place}"
            (folder / "frames").mkdir(parents=True, exist_ok=True)
            if number == 0:
                (folder / "scene.yaml").write_text(dump_scene(camera.scene))
            both = camera.pair(number, DT_S, number / RATE_HZ)
            for letter, frame in zip("ab", both, strict=True):
                tifffile.imwrite(folder / "frames" / f"{number:05d}_{letter}.tif", frame)
    folders = [said.frames / f"camera{place + 1}" for place in range(len(said.degrees))]
    print("rtpiv mean --join", *(folder / "frames" for folder in folders), "--scene",
          *(folder / "scene.yaml" for folder in folders), "--dt-us", 1e6 * DT_S,
          "" if said.moved else "--simultaneous", "-o", said.frames / "joined")  # fmt: skip


def judge(said: argparse.Namespace) -> dict[str, Any]:
    """Errors of the joined views in pixels, by the region of the first view."""
    out = said.judge
    first = SeriesView(out / "view-1")
    flow = flow_of(said.name, said.size, said.seed, said.turbulence)
    mean = read_vectors((out / "mean.nc").read_bytes())
    x, y = np.meshgrid(mean.x_mm, mean.y_mm)
    nodes = np.column_stack((x.ravel(), y.ravel(), np.zeros(x.size)))
    to_px = DT_S * float(mean.attributes["px_per_mm"])  # of mm/s
    steady = (flow.mean(nodes) * to_px).reshape(*x.shape, 3)
    regions = _regions(first, mean)
    found = {"mean": _errors(mean, 0, steady, regions, to_px)}
    moments, per_pair = np.zeros_like(steady), list[dict[str, Any]]()
    for file in sorted((out / "chunks").glob("*.nc")):
        vectors = read_vectors(file.read_bytes())
        for k in range(len(vectors.times)):
            true = flow.velocity(nodes, len(per_pair) / RATE_HZ + 0.5 * DT_S).reshape(*x.shape, 3) * to_px
            per_pair.append(_errors(vectors, k, true, regions, to_px))
            moments += true
    if per_pair:
        found["mean, against the flow at the times of the pairs"] = _errors(
            mean, 0, moments / len(per_pair), regions, to_px
        )
        found["pairs"] = {
            name: np.mean([part[name] for part in per_pair if name in part], axis=0).round(4).tolist()
            for name in per_pair[0]
        }
    if flow.modes is not None and "R_ww" in mean.fields:
        for name in ("R_uu", "R_vv", "R_ww", "R_uv", "R_uw", "R_vw"):
            values = mean.fields[name][0] * (1e3 * to_px) ** 2
            found[name] = {
                where: round(float(np.nanmean(values[here])), 4) for where, here in regions.items() if here.any()
            }
    return found


def _regions(first: SeriesView, mean: Vectors) -> dict[str, Array]:
    uv = np.stack([mean.fields[name][0] for name in "uv"], axis=-1).astype(float)
    field = image_field(uv, np.ones_like(uv), 1.0, first.windows)
    found = regions_of(field, first.correction.corrector.map, first.scene)
    region, radius, both = found.region[::-1], found.radius[::-1], mean.fields["views"][0] > 1
    glass = region == Region.GLASS
    places = {
        "beside": region == Region.DIRECT,
        "r < 0.75 R": glass & (radius < LIMIT),
        "farther out": glass & (radius >= LIMIT),
        "rim": region == Region.RIM,
    }
    inner = np.zeros_like(both)
    inner[2:-2, 2:-2] = True
    return {name: here & inner for name, here in places.items()}


def _errors(vectors: Vectors, k: int, true_px: Array, regions: dict[str, Array], to_px: float) -> dict[str, Any]:
    """Vectors, squares of errors and of sigmas, and shares within one sigma, by region and component."""
    found: dict[str, Any] = {}
    for where, here in regions.items():
        for axis, name in enumerate("uvw"):
            value, sigma = (vectors.fields[f"{before}{name}"][k] * 1e3 * to_px for before in ("", "total_sigma_"))
            off = (value - true_px[..., axis])[here]
            good = np.isfinite(off)
            off, sigma = off[good], sigma[here][good]
            if off.size:
                rms, typical = (float(np.sqrt(np.mean(np.square(part)))) for part in (off, sigma))
                within = float(np.mean(np.abs(off) < sigma))
                found[f"{where}, {name}"] = [
                    round(float(good.mean()), 3),
                    round(float(off.mean()), 4),
                    round(rms, 4),
                    round(typical, 4),
                    round(within, 3),
                ]
    return found


def main() -> None:
    """Make or judge."""
    parser = argparse.ArgumentParser(description="Several cameras before one known flow.")
    parser.add_argument("name", choices=tuple(SCENES))
    parser.add_argument("--degrees", type=float, nargs="+", default=[0.0, 15.0])
    parser.add_argument("--tilts", type=float, nargs="+", default=[], help="of the sensors about v, degrees")
    parser.add_argument("--pairs", type=int, default=40)
    parser.add_argument("--size", type=int, default=504)
    parser.add_argument("--seed", type=int, default=3)
    parser.add_argument("--turbulence", type=float, default=0.2, help="px, each component")
    parser.add_argument("--moved", action="store_true", help="one camera that was moved between runs")
    parser.add_argument("--sheet", type=float, nargs=3, default=[0.0, 0.0, 0.0], help="z [mm], slopes along x, y")
    parser.add_argument("--drift", type=float, nargs=3, default=[0.0, 0.0, 0.0], help="um, of the first ball")
    parser.add_argument("--knock", type=int, help="pair before which it is moved at once, in place of a drift")
    parser.add_argument("--frames", type=Path)
    parser.add_argument("--judge", type=Path)
    said = parser.parse_args()
    if said.frames is not None:
        write_frames(said)
    if said.judge is not None:
        for name, lines in judge(said).items():
            print(name)
            for key, value in lines.items():
                print(f"  {key:<18} {value}")


if __name__ == "__main__":
    main()
