"""Pairs as labs have them, with truth: bodies, glare, dark areas, text, fixed patterns, shaking cameras.

Particles are drawn here, as sums of point-sampled Gaussians of uneven brightness on an 8-bit sensor; nothing is
shared with the evaluator or with other generators of the tests.
"""

from dataclasses import dataclass
from dataclasses import field as made_by

import numpy as np
import scipy

SIDE = 256
BASE, PEAK, NOISE = 10.0, 160.0, 2.0  # sensor offset, brightest particle, noise of a pixel [counts of 255]


def uniform(u, v):
    """The same displacement everywhere."""
    return lambda x, y: (u + 0 * x, v + 0 * y)


def shear(x, y):
    """Displacement of 2 to 5 px that grows downwards."""
    return 2.0 + 3.0 * y / SIDE, 1.2 + 0 * x


def swirl(x, y):
    """Rotation about the middle, on a drift."""
    return 3.0 - 0.015 * (y - SIDE / 2), 1.0 + 0.015 * (x - SIDE / 2)


def over_wall(first_row, layer_px=10.0):
    """Boundary layer above a wall that begins at `first_row`."""
    return lambda x, y: (4.5 * (1.0 - np.exp(-np.maximum(first_row - y, 0.0) / layer_px)), 0 * x)


@dataclass
class Scene:
    """A pair (A, B) of uint8 frames; truth(x, y); `solid` (H, W), where no flow is; `hopeless`: no flow at all."""

    a: np.ndarray
    b: np.ndarray
    truth: object
    solid: np.ndarray = made_by(default_factory=lambda: np.zeros((SIDE, SIDE), bool))
    hopeless: bool = False
    clean: bool = False


def spots(x, y, peak, sigma_px):
    """Frame of Gaussian particle images."""
    reach = int(np.ceil(4.5 * sigma_px))
    around = np.arange(-reach, reach + 1)
    rim = reach + 1
    keep = (x > -rim) & (x < SIDE + rim - 1) & (y > -rim) & (y < SIDE + rim - 1)
    x, y, peak = x[keep], y[keep], peak[keep]
    column, row = np.rint(x).astype(int), np.rint(y).astype(int)
    along, down = (
        np.exp(-((place[:, None] + around - true[:, None]) ** 2) / (2 * sigma_px**2))
        for place, true in ((column, x), (row, y))
    )
    wide = SIDE + 4 * rim
    at = (row[:, None, None] + around[:, None] + 2 * rim) * wide + column[:, None, None] + around + 2 * rim
    total = np.bincount(at.ravel(), (peak[:, None, None] * down[:, :, None] * along[:, None, :]).ravel(), wide**2)
    return total.reshape(wide, wide)[2 * rim : -2 * rim, 2 * rim : -2 * rim]


def particles(rng, flow, solid=None, density=0.03, sigma_px=0.85, loss=0.05, peak=PEAK):
    """Light of both exposures without background; no particle's middle lies in `solid`."""
    margin = 48
    count = int(density * (SIDE + 2 * margin) ** 2)
    x, y = rng.uniform(-margin, SIDE + margin, (2, count))
    bright = peak * rng.uniform(0.3, 1.0, count)
    if solid is not None:
        at = tuple(np.clip(np.rint(place), 0, SIDE - 1).astype(int) for place in (y, x))
        inside = (x > 0) & (x < SIDE) & (y > 0) & (y < SIDE)
        keep = ~(inside & solid[at])
        x, y, bright = x[keep], y[keep], bright[keep]
    du, dv = flow(x, y)
    lost = rng.uniform(size=len(x)) < loss
    frames = []
    for number, sign in enumerate((-0.5, 0.5)):
        light = bright
        if number:
            # Particles that left the sheet are replaced by others elsewhere.
            x, y = (np.where(lost, rng.permutation(part), part) for part in (x, y))
        frames.append(spots(x + sign * du, y + sign * dv, light, sigma_px))
    return frames


def exposed(rng, lights, noise=NOISE):
    """Frames as an 8-bit sensor records them."""
    return [np.clip(np.rint(one + rng.normal(0, noise, one.shape)), 0, 255).astype(np.uint8) for one in lights]


def grid():
    """Pixel positions x, y."""
    y, x = np.mgrid[:SIDE, :SIDE].astype(float)
    return x, y


def disc(x0, y0, radius):
    """Pixels within a circle."""
    x, y = grid()
    return np.hypot(x - x0, y - y0) < radius


def box(rows, columns):
    """Pixels of a rectangle."""
    found = np.zeros((SIDE, SIDE), bool)
    found[slice(*rows), slice(*columns)] = True
    return found


def bar(x0, y0, angle, half_width):
    """Pixels of an endless inclined bar."""
    x, y = grid()
    return np.abs((x - x0) * np.sin(angle) - (y - y0) * np.cos(angle)) < half_width


def body_scene(seed, solid, flow, level, texture, grain_px=1.0, light=(1.0, 1.0), shake=(0.0, 0.0), **image):
    """A solid of `level` (of 255, may exceed 1) and relative `texture`, whose edge is a pixel soft."""
    rng = np.random.default_rng(seed)
    full = lambda x, y: tuple(part + shift for part, shift in zip(flow(x, y), shake, strict=True))  # noqa: E731
    flowing = particles(rng, full, solid, **image)
    rough = scipy.ndimage.gaussian_filter(rng.normal(size=(SIDE, SIDE)), grain_px)
    rough /= rough.std()
    share = scipy.ndimage.gaussian_filter(solid.astype(float), 0.7)
    body = share * np.clip(255.0 * level * (1.0 + texture * rough) - BASE, 0.0, None)
    lights = []
    for light_of, one, sign in zip(light, flowing, (-0.5, 0.5), strict=True):
        moved = body
        if any(shake):
            moved = scipy.ndimage.shift(body, (sign * shake[1], sign * shake[0]), order=3, mode="nearest")
        lights.append(BASE + light_of * (one + moved))
    return Scene(*exposed(rng, lights), full, solid)


def behind(
    seed, flow, fixed, lights=(1.0, 1.0), fixed_lights=(1.0, 1.0), shadow=None, clean=False, noise=NOISE, **image
):
    """A flow with something `fixed` (H, W) added to both frames, and multiplied by shadow(x, y, number)."""
    rng = np.random.default_rng(seed)
    found = []
    for number, (one, light, still) in enumerate(
        zip(particles(rng, flow, **image), lights, fixed_lights, strict=True)
    ):
        shade = 1.0 if shadow is None else shadow(*grid(), number)
        found.append(BASE + light * shade * one + still * fixed)
    return Scene(*exposed(rng, found, noise), flow, clean=clean)


def rough(seed, deviation, grain_px=0.85):
    """Random texture of a standard deviation in those of the particles' light (about 20 counts)."""
    made = scipy.ndimage.gaussian_filter(np.random.default_rng(seed).normal(size=(SIDE, SIDE)), grain_px)
    made *= 20.0 * deviation / made.std()
    return made - made.min()


def hot_pixels(seed, share, height=200.0):
    """Single bright pixels."""
    rng = np.random.default_rng(seed)
    return np.where(rng.uniform(size=(SIDE, SIDE)) < share, rng.uniform(0.3, 1.0, (SIDE, SIDE)) * height, 0.0)


def written(seed, a, b, top, left, cell_px=4, letters=12, changing=3):
    """Blocky digits burnt into both frames, the last of which differ between them."""
    rng = np.random.default_rng(seed)
    for number in range(letters):
        shapes = [rng.random((5, 3)) > 0.5] * 2 if number < letters - changing else rng.random((2, 5, 3)) > 0.5
        for frame, shape in zip((a, b), shapes, strict=True):
            row, column = top, left + number * (3 * cell_px + 2)
            frame[row : row + 5 * cell_px, column : column + 3 * cell_px] = 255 * np.kron(
                shape, np.ones((cell_px, cell_px))
            )


def text_scene(seed, flow, top=8, left=10, **how):
    """A flow under an info line."""
    scene = behind(seed, flow, 0.0)
    written(seed, scene.a, scene.b, top, left, **how)
    return scene


def drawn_over(seed, flow, *boxes):
    """A flow under white bars."""
    scene = behind(seed, flow, 0.0)
    for frame in (scene.a, scene.b):
        for one in boxes:
            frame[one] = 255
    return scene


def dark_scene(seed, flow, dark, level=0.0, soft_px=0.0):
    """A flow of which a part receives no light, neither in particles nor in background."""
    rng = np.random.default_rng(seed)
    light = 1.0 - dark.astype(float)
    if soft_px:
        light = scipy.ndimage.gaussian_filter(light, soft_px)
    found = [BASE * (level + (1 - level) * light) + light * one for one in particles(rng, flow)]
    frames = exposed(rng, found)
    if not level:
        frames = [np.where(dark, 0, frame).astype(np.uint8) if not soft_px else frame for frame in frames]
    return Scene(*frames, flow, dark)


def strangers(seed, **image):
    """Frames that have nothing in common."""
    one, other = (behind(seed + k, uniform(3.0, 1.0), 0.0, **image) for k in (0, 1))
    return Scene(one.a, other.b, uniform(3.0, 1.0), hopeless=True)


def band_of_shadow(speed_px, depth=0.9, width_px=30.0):
    """Darkness that moves otherwise than the flow."""
    return lambda x, y, number: 1.0 - depth * np.exp(-(((x + y - 180 - number * speed_px) / width_px) ** 4))


def scenes():
    """Name -> callable that makes a scene."""
    x, y = grid()
    glow = np.exp(-(((x - 150) ** 2 + (y - 90) ** 2) / (2 * 25.0**2)))
    columns = 25.0 * np.sin(2 * np.pi * np.arange(SIDE) / 7.0)[None, :] * np.ones((SIDE, 1))
    column_noise = np.random.default_rng(77).normal(0, 20, SIDE)[None, :] * np.ones((SIDE, 1))
    vignette = np.hypot(x - 128, y - 128) > 115
    move, drift = uniform(3.4, -1.7), uniform(-2.6, 4.1)
    return {
        "wall 0.08, texture 50 %": lambda: body_scene(1, box((190, 256), (0, 256)), over_wall(190), 0.08, 0.5),
        "wall 0.15, plain": lambda: body_scene(2, box((180, 256), (0, 256)), over_wall(180), 0.15, 0.0),
        "wall 0.35, texture 10 %": lambda: body_scene(3, box((0, 256), (0, 70)), move, 0.35, 0.1, 1.5),
        "wall saturated": lambda: body_scene(4, box((170, 256), (0, 256)), over_wall(170), 1.6, 0.1),
        "disc 0.08, plain": lambda: body_scene(5, disc(128, 120, 45), move, 0.08, 0.0),
        "disc 0.2, texture 30 %": lambda: body_scene(6, disc(110, 140, 40), drift, 0.2, 0.3),
        "disc 0.5, texture 5 %": lambda: body_scene(7, disc(150, 110, 50), shear, 0.5, 0.05, 2.0),
        "disc saturated": lambda: body_scene(8, disc(128, 128, 45), move, 1.5, 0.0),
        "disc saturated, light 0.7": lambda: body_scene(9, disc(100, 150, 35), shear, 1.3, 0.2, light=(1.0, 0.7)),
        "bar 0.1, texture 50 %": lambda: body_scene(10, bar(128, 128, 0.5, 18), move, 0.1, 0.5, 2.0),
        "bar 0.3, plain": lambda: body_scene(11, bar(128, 128, 1.2, 14), drift, 0.3, 0.0),
        "bar saturated": lambda: body_scene(12, bar(110, 128, 2.3, 16), shear, 1.4, 0.3),
        "wall 0.25, shaking": lambda: body_scene(
            13, box((185, 256), (0, 256)), over_wall(185), 0.25, 0.3, shake=(0.8, -0.6)
        ),
        "disc 0.6, shaking": lambda: body_scene(14, disc(128, 128, 42), move, 0.6, 0.2, shake=(-1.3, 0.7)),
        "two discs 0.9 and light 1.2": lambda: body_scene(
            15, disc(80, 90, 28) | disc(180, 170, 36), shear, 0.9, 0.15, light=(0.9, 1.08)
        ),
        "glare, smooth": lambda: behind(20, move, 120.0 * glow),
        "glare, saturated": lambda: behind(21, drift, 500.0 * glow),
        "glare that flickers": lambda: behind(22, shear, 180.0 * glow, fixed_lights=(1.0, 0.7)),
        "black rows 0 to 52": lambda: dark_scene(23, uniform(3.4, 1.7), box((0, 53), (0, 256))),
        "black corners": lambda: dark_scene(24, drift, vignette),
        "soft dark side": lambda: dark_scene(25, shear, box((0, 256), (0, 60)), 0.5, 6.0),
        "dark disc": lambda: body_scene(26, disc(128, 128, 40), move, 0.04, 0.0),
        "black disc": lambda: body_scene(27, disc(120, 130, 42), drift, 0.0, 0.0),
        "info line": lambda: text_scene(28, uniform(3.4, -1.7)),
        "info line below": lambda: text_scene(29, drift, top=226, left=60, cell_px=3, letters=14),
        "scale bar": lambda: drawn_over(30, uniform(3.4, -1.7), np.s_[230:240, 30:130]),
        "cross hairs": lambda: drawn_over(31, shear, np.s_[126:129, :], np.s_[:, 126:129]),
        "texture 0.5": lambda: behind(32, move, rough(1, 0.5)),
        "texture 1.0": lambda: behind(33, drift, rough(2, 1.0)),
        "texture 1.5": lambda: behind(34, uniform(4.4, 2.3), rough(3, 1.5)),
        "texture 2.0, coarse": lambda: behind(35, move, rough(4, 2.0, 2.5)),
        "hot pixels 0.5 %": lambda: behind(36, move, hot_pixels(5, 0.005)),
        "hot pixels 5 %": lambda: behind(37, swirl, hot_pixels(6, 0.05)),
        "columns": lambda: behind(38, move, columns + 25.0),
        "column noise": lambda: behind(39, drift, column_noise - column_noise.min()),
        "moving shadow": lambda: behind(40, move, 0.0, shadow=band_of_shadow(9.0)),
        "moving shadow, sharp": lambda: behind(41, swirl, 0.0, shadow=band_of_shadow(-14.0, 1.0, 40.0)),
        "unequal light": lambda: behind(42, shear, 0.0, lights=(1.0, 0.3)),
        "strangers": lambda: strangers(43),
        "strangers, dense": lambda: strangers(45, density=0.06),
    }


def clean_scenes():
    """Pairs in which nothing is to be found or lost."""
    rest = lambda x, y: (np.where(y < 120, 4.0, 0.0), 0 * x)  # noqa: E731
    vortex = lambda x, y: tuple(  # noqa: E731
        s * 0.12 * p * np.exp(-((x - 128) ** 2 + (y - 128) ** 2) / (2 * 40.0**2))
        for s, p in ((-1, y - 128), (1, x - 128))
    )
    return {
        "uniform": lambda: behind(50, uniform(3.4, -1.7), 0.0),
        "slow": lambda: behind(51, uniform(0.4, -0.3), 0.0),
        "at rest": lambda: behind(52, uniform(0.0, 0.0), 0.0),
        "rest beside flow": lambda: behind(53, rest, 0.0),
        "rest, thin": lambda: behind(54, rest, 0.0, density=0.006),
        "vortex in a fluid at rest": lambda: behind(55, vortex, 0.0),
        "swirl": lambda: behind(56, swirl, 0.0),
        "thin seeding": lambda: behind(57, shear, 0.0, density=0.006),
        "dense": lambda: behind(58, swirl, 0.0, density=0.1),
        "large particles": lambda: behind(59, shear, 0.0, density=0.01, sigma_px=2.0),
        "large, slow": lambda: behind(60, uniform(1.1, 0.4), 0.0, density=0.01, sigma_px=2.5),
        "lossy": lambda: behind(61, shear, 0.0, loss=0.3),
        "uneven light": lambda: behind(
            62, shear, 0.0, shadow=lambda x, y, number: 0.25 + 0.75 * np.exp(-(((y - 128) / 80) ** 2))
        ),
        "uneven light, slow": lambda: behind(
            63, uniform(0.7, 0.2), 0.0, shadow=lambda x, y, number: 0.2 + 0.8 * np.exp(-(((x - 128) / 60) ** 2))
        ),
        "saturated particles": lambda: behind(64, shear, 0.0, peak=900.0, density=0.015),
    }
