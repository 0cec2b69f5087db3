"""Kinds of picture that labs have, each with five flows: how many valid vectors are wrong, or silently so.

`python -m tests.piv.lab_kinds --first-seed S` prints a table. Images of particles are integrated over pixels, the
light of each changes as it crosses a Gaussian sheet, and the sensor has shot noise; nothing is shared with the
simulator, nor with `tests.piv.hard_scenes`.
"""

import argparse
from typing import NamedTuple

import cv2
import numpy as np
import scipy

from piv.correlation.pair import evaluate_pair
from piv.correlation.settings import PivSettings

FLOWS = "uniform", "shear", "vortex", "jet", "turbulence"


class Counts(NamedTuple):
    """Numbers of vectors in the fluid: all, valid, wrong by 1 px, silent; and of pairs with a warning."""

    asked: int
    valid: int
    wrong: int
    silent: int
    warned: int

    @property
    def said(self):
        """Percentages for a table."""
        wrong, silent = (100.0 * number / max(self.valid, 1) for number in (self.wrong, self.silent))
        share = 100.0 * self.valid / self.asked
        return f"wrong {wrong:6.2f} silent {silent:6.2f} valid {share:5.1f} %, {self.warned} warned"


def flow_of(name, rng, side, speed_px):
    """Displacement [px] at places x, y, at most about `speed_px`."""
    angle, turn = rng.uniform(0.0, 2 * np.pi), rng.choice([-1.0, 1.0])
    across = lambda x, y: (x - side / 2) * np.sin(angle) - (y - side / 2) * np.cos(angle)  # noqa: E731
    if name == "turbulence":
        k = rng.normal(size=(24, 2)) * 2 * np.pi / rng.uniform(0.25 * side, 0.6 * side, (24, 1))
        phase, height = rng.uniform(0, 2 * np.pi, 24), 0.25 * speed_px / np.linalg.norm(k, axis=1)

        def waves(x, y):
            bent = height * np.cos(x[..., None] * k[:, 0] + y[..., None] * k[:, 1] + phase)
            return (bent * k[:, 1]).sum(-1), -(bent * k[:, 0]).sum(-1)

        return waves
    if name == "vortex":
        core = side / rng.uniform(3.5, 5.0)

        def around(x, y):
            dx, dy = x - side / 2, y - side / 2
            rate = turn * 1.6 * speed_px / core * np.exp(-(dx**2 + dy**2) / (2 * core**2))
            return -rate * dy, rate * dx

        return around
    profile = {
        "uniform": lambda s: 1.0 + 0 * s,
        "shear": lambda s: 0.5 + s / side,
        "jet": lambda s: 0.25 + 0.75 * np.exp(-((4.0 * s / side) ** 2)),
    }[name]

    def along(x, y):
        speed = speed_px * profile(across(x, y))
        return speed * np.cos(angle), speed * np.sin(angle)

    return along


def draw(frame, x, y, light, spread_px):
    """Add images of particles, integrated over pixels."""
    reach = int(np.ceil(4.0 * spread_px)) + 1
    pixels = np.arange(-reach, reach + 1)
    seen = (np.abs(x - frame.shape[1] / 2) < frame.shape[1]) & (np.abs(y - frame.shape[0] / 2) < frame.shape[0])
    x, y, light = x[seen], y[seen], light[seen]
    row, column = np.floor(y + 0.5).astype(int), np.floor(x + 0.5).astype(int)
    edges = np.arange(-reach, reach + 2) - 0.5
    down, right = (
        np.diff(scipy.special.ndtr((edges + at[:, None] - place[:, None]) / spread_px), axis=1)
        for at, place in ((row, y), (column, x))
    )
    image = light[:, None, None] * down[:, :, None] * right[:, None, :] * 2 * np.pi * spread_px**2
    rows, columns = row[:, None, None] + pixels[None, :, None], column[:, None, None] + pixels
    rows, columns = np.broadcast_arrays(rows, columns)
    inside = (rows >= 0) & (rows < frame.shape[0]) & (columns >= 0) & (columns < frame.shape[1])
    np.add.at(frame, (rows[inside], columns[inside]), image[inside])


def light_of_particles(rng, flow, side, spread_px=0.9, density=0.03, through=0.1, peak=120.0):
    """Both exposures (2, side, side); particles cross `through` of the sheet's half width."""
    margin = 40
    count = int(density * (side + 2 * margin) ** 2)
    x, y = rng.uniform(-margin, side + margin, (2, count))
    z = rng.uniform(-1.6, 1.6, count)
    light = peak * rng.lognormal(0.0, 0.4, count)
    u, v = flow(x, y)
    frames = np.zeros((2, side, side))
    for frame, part in zip(frames, (-0.5, 0.5), strict=True):
        draw(frame, x + part * u, y + part * v, light * np.exp(-2.0 * (z + part * through) ** 2), spread_px)
    return frames


def texture(rng, side, grain_px, kind="random"):
    """Still light of deviation 1 and minimum 0: random, or a dust of points as sharp as the particles."""
    if kind == "points":
        made = np.zeros((side, side))
        count = int(0.03 * side**2)
        draw(made, *rng.uniform(0, side, (2, count)), rng.lognormal(0.0, 0.5, count), grain_px)
    else:
        made = cv2.GaussianBlur(rng.normal(size=(side, side)), (0, 0), grain_px)
    made -= made.min()
    return made / made.std()


def sensor(rng, lights, noise=1.5, black=8.0):
    """Counts of 8 bits with shot and read noise."""
    mean = np.clip(np.asarray(lights) + black, 0.0, None)
    return np.clip(np.rint(mean + rng.normal(size=mean.shape) * np.sqrt(noise**2 + 0.06 * mean)), 0, 255).astype(
        np.uint8
    )


def squeezed(frames, quality):
    """Frames as JPEG leaves them."""
    how = [cv2.IMWRITE_JPEG_QUALITY, quality]
    return [cv2.imdecode(cv2.imencode(".jpg", one, how)[1], cv2.IMREAD_UNCHANGED) for one in frames]


def scene(kind, name, seed):
    """Frames A and B, the true displacement at places, and where a body hides the flow."""
    rng = np.random.default_rng([seed, *kind.encode(), *name.encode()])
    side = int(rng.integers(80, 116)) if kind == "small, glare" else 224
    y, x = np.mgrid[:side, :side].astype(float)
    slowest, fastest = {"clean": (0.0, 2.0), "still": (0.5, 4.5), "fast": (10.0, 18.0)}.get(
        kind.partition(",")[0], (0.5, 6.0)
    )
    speed = rng.uniform(slowest, fastest)
    flow = flow_of(name, rng, side, speed)
    image = {
        "spread_px": rng.uniform(0.7, 1.3),
        "density": rng.uniform(0.02, 0.05),
        "through": rng.uniform(0, 0.3),
    }
    if kind == "sparse":
        image["density"] = rng.uniform(0.004, 0.01)
    if kind == "clean, lossy":
        image["through"] = rng.uniform(0.3, 0.8)
    lights = light_of_particles(rng, flow, side, **image)
    deviation = lights.std()
    solid = np.zeros((side, side), bool)
    middle = rng.uniform(0.3, 0.7, 2) * side
    away = np.hypot(x - middle[0], y - middle[1])
    if kind == "body":
        solid = away < rng.uniform(0.12, 0.2) * side
        made = 255 * rng.uniform(0.2, 1.2) * (1 + rng.uniform(0.0, 0.3) * texture(rng, side, 1.2))
        lights = np.where(solid, made, lights)
    elif kind == "dark area":
        solid = x < rng.uniform(0.15, 0.3) * side
        lights = np.where(solid, -8.0, lights)
    elif "glare" in kind:
        lights = lights + rng.uniform(100.0, 400.0) * np.exp(-((away / rng.uniform(0.1, 0.16) / side) ** 2))
    elif kind == "still, fine":
        lights = lights + rng.uniform(1.0, 3.0) * deviation * texture(rng, side, rng.uniform(0.6, 1.2))
    elif kind == "still, points":
        lights = lights + rng.uniform(1.0, 3.0) * deviation * texture(rng, side, image["spread_px"], "points")
    elif kind == "still, coarse":
        lights = lights + rng.uniform(1.0, 3.0) * deviation * texture(rng, side, rng.uniform(1.5, 3.5))
    elif kind == "still, dim":
        lights = lights + rng.uniform(0.4, 1.0) * deviation * texture(rng, side, rng.uniform(0.7, 1.5))
    elif kind == "still, hot":
        lights = lights + np.where(rng.uniform(size=x.shape) < rng.uniform(0.01, 0.06), 120.0, 0.0)
    elif kind == "unequal":
        lights = lights * np.array([1.0, rng.uniform(0.3, 0.6)])[:, None, None]
    elif kind == "shadow":
        way = np.array([-0.5, 0.5])[:, None, None] * rng.uniform(6.0, 14.0)
        lights = lights * (1.0 - 0.9 * np.exp(-(((x + y - side - way) / 30.0) ** 4)))
    frames = sensor(rng, lights)
    if kind == "text":
        digits = rng.random((2, 10, 5, 3)) > 0.5
        digits[1, :7] = digits[0, :7]
        cell, at = int(rng.integers(3, 6)), int(rng.integers(4, 20))
        for frame, each in zip(frames, digits, strict=True):
            for number, shape in enumerate(each):
                left = at + number * (3 * cell + 3)
                frame[at : at + 5 * cell, left : left + 3 * cell] = 255 * np.kron(shape, np.ones((cell, cell)))
    elif kind == "video":
        frames = squeezed(frames, int(rng.integers(25, 70)))
    return *frames, flow, solid


KINDS = (
    "body", "dark area", "glare", "small, glare", "text", "still, fine", "still, points", "still, coarse",
    "still, dim", "still, hot", "unequal", "shadow", "sparse", "fast", "video", "clean", "clean, lossy",
)  # fmt: skip


def judge(kind, name, seed):
    """Counts of one pair."""
    a, b, flow, solid = scene(kind, name, seed)
    field = evaluate_pair(a, b, settings=PivSettings(finest_px=16), threads=1)
    x, y = np.meshgrid(field.x_px, field.y_px)
    at = np.rint(y).astype(int), np.rint(x).astype(int)
    off = np.stack((field.u_px, field.v_px), -1) - np.stack(flow(x, y), -1)
    far, over = np.linalg.norm(off, axis=-1), np.abs(off / field.total_sigma_px).max(axis=-1)
    fluid = scipy.ndimage.distance_transform_edt(~solid)[at] > 0.0 if solid.any() else np.ones(x.shape, bool)
    counted = field.valid & fluid
    return Counts(
        int(fluid.sum()),
        int(counted.sum()),
        int((counted & (far > 1.0)).sum()),
        int((counted & (far > 0.3) & (over > 5.0)).sum()),
        int("not move" in field.warning),
    )


def main():
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kind", nargs="*", default=KINDS)
    parser.add_argument("--flow", nargs="*", default=FLOWS)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--first-seed", type=int, default=4100)
    told = parser.parse_args()
    for kind in told.kind:
        seeds = range(told.first_seed, told.first_seed + told.seeds)
        found = [judge(kind, name, seed) for name in told.flow for seed in seeds]
        print(f"{kind:16} {Counts(*np.sum(found, axis=0)).said}", flush=True)


if __name__ == "__main__":
    main()
