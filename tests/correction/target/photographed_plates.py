"""Photographs of plates on two levels by ray tests of their own, which share no line with the simulator.

White dots on black, or black ones on white, rows staggered by half a pitch, every second row at the bottom of
a groove with walls; oblique light with shadows, soft edges, a reflection, uneven light, things in front, blur,
noise, and JPEG for most.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from correction.target.board_file import PrintedBoard

STYLES = ("plain", "gloss", "covered", "dim", "blur", "small", "hard")
STEPS_MM = {10.0: 2.0, 15.0: 3.0, 5.0: 1.0}
DOTS_MM = {10.0: 2.2, 15.0: 3.0, 5.0: 1.2}


@dataclass(frozen=True)
class View:
    """A pinhole camera with one lens term; it looks along the third row of `axes`."""

    axes: np.ndarray
    place_mm: np.ndarray
    focal_px: float
    middle_px: np.ndarray
    k1: float

    def project(self, points_mm):
        there = (np.asarray(points_mm, float) - self.place_mm) @ self.axes.T
        flat = there[..., :2] / there[..., 2:]
        return self.focal_px * flat * (1.0 + self.k1 * (flat**2).sum(-1, keepdims=True)) + self.middle_px

    def rays(self, pixel):
        seen = (pixel - self.middle_px) / self.focal_px
        flat = seen.copy()
        for _ in range(6):
            flat = seen / (1.0 + self.k1 * (flat**2).sum(-1, keepdims=True))
        return np.concatenate((flat, np.ones((*flat.shape[:-1], 1))), -1) @ self.axes


def view_at(rng, size, pitch, across, tilt_deg, roll, k1):
    """Look at the plate from aside, mostly along x."""
    focal_px = size[0] * rng.uniform(1.5, 4.0)
    tilt, towards = np.deg2rad(tilt_deg), rng.uniform(0, 2 * np.pi)
    if rng.random() < 0.7:
        towards = 0 if rng.random() < 0.5 else np.pi
    towards += rng.normal(0, 0.1)
    away = np.array((np.sin(tilt) * np.cos(towards), np.sin(tilt) * np.sin(towards), np.cos(tilt)))
    place = focal_px * across * pitch / size[0] * away
    ahead = np.array((*rng.uniform(-0.12, 0.12, 2) * across * pitch, 0.0)) - place
    ahead /= np.linalg.norm(ahead)
    right = np.cross(ahead, (0.0, 1.0, 0.0))
    right /= np.linalg.norm(right)
    down = np.cross(ahead, right)
    axes = np.stack(
        (np.cos(roll) * right + np.sin(roll) * down, np.cos(roll) * down - np.sin(roll) * right, ahead)
    )
    return View(axes, place, focal_px, (np.array(size) - 1) / 2, k1)


@dataclass(frozen=True)
class Made:
    """A plate by its measures; `square` and `triangle` are the places of its marks [mm]."""

    pitch: float
    step: float
    dot: float
    square: tuple
    triangle: tuple
    mark: float
    bright_dots: bool = True

    @property
    def board(self):
        words = {"kind": "dots", "pitch_mm": self.pitch, "dot_mm": self.dot, "rows": "staggered", "levels": "rows"}
        marks = {"square": list(self.square), "triangle": list(self.triangle)}
        return PrintedBoard(**words, bright_dots=self.bright_dots, step_mm=self.step, marks_mm=marks).board()

    def nearest_row(self, y, parity):
        half = self.pitch / 2
        row = np.rint(y / half)
        return np.where(row.astype(int) % 2 == parity, row, np.where(y / half > row, row + 1, row - 1))

    def cover(self, x, y, parity, soft):
        """Reflectance, 0 to 1, at places on the level of rows of one parity."""
        half, row = self.pitch / 2, self.nearest_row(y, parity)
        off = np.where(row.astype(int) % 2 == 0, 0, half)
        beside = x - off - np.rint((x - off) / self.pitch) * self.pitch
        white = np.clip((self.dot / 2 - np.hypot(beside, y - row * half)) / soft + 0.5, 0, 1)
        for at in (self.square, self.triangle):
            if round(at[1] / half) % 2 != parity:
                continue
            dx, dy, width = np.abs(x - at[0]), y - at[1], self.dot * 0.55 * self.mark
            if at == self.square:
                inside = self.dot * 0.5 * self.mark - np.maximum(dx, np.abs(dy))
            else:
                inside = np.minimum(dy + 0.6 * width, (1.2 * width - dy - np.sqrt(3) * dx) / 2)
            white = np.maximum(white, np.clip(inside / soft + 0.5, 0, 1))
        return white if self.bright_dots else 1.0 - white


def place_of_mark(rng, pitch):
    row = int(rng.integers(-2, 3))
    return (int(rng.integers(-2, 2)) + 0.5) * pitch + (pitch / 2 if row % 2 else 0), row * pitch / 2


def photograph(seed, bright_dots=True):
    """A frame (H, W) uint8 by its number, the plate in it, the view, and the style of the light."""
    rng, style = np.random.default_rng((seed, 4711)), STYLES[seed % 7]
    width = int(rng.choice([720, 900, 1100]))
    height = int(width * rng.choice([0.75, 0.8, 1.0]))
    pitch = float(rng.choice([10.0, 15.0, 5.0, 15.0]))
    step = 1.0 if rng.random() < 0.3 else STEPS_MM[pitch]
    dot = float(rng.uniform(0.15, 0.29) * pitch)
    dot = DOTS_MM[pitch] if rng.random() < 0.5 else dot
    square = triangle = place_of_mark(rng, pitch)
    while triangle == square:
        triangle = place_of_mark(rng, pitch)
    sign = 1 if rng.random() < 0.7 else -1
    made = Made(pitch, step * sign, dot, square, triangle, rng.uniform(0.85, 1.4), bright_dots)
    across = rng.uniform(16, 24) if style == "small" else rng.uniform(6.5, 15)
    tilt, roll, k1 = rng.uniform(0, 40), np.deg2rad(rng.uniform(-8, 8)), rng.uniform(-0.4, 0.3)
    view = view_at(rng, (width, height), pitch, across, tilt, roll, k1)
    light = sum(_sampled(np.random.default_rng((seed, 1)), made, view, style, across, (width, height), at)
                for at in ((-0.25, -0.25), (-0.25, 0.25), (0.25, -0.25), (0.25, 0.25)))  # fmt: skip
    return _exposed(rng, light / 4, style), made, view, style


def _sampled(rng, made, view, style, across, size, at):
    """Light (H, W) along the rays of one point in every pixel; the same numbers are drawn for every point."""
    pitch, half, around = made.pitch, made.pitch / 2, across * made.pitch
    azimuth, height = rng.uniform(0, 2 * np.pi), np.deg2rad(rng.uniform(20, 70))
    lamp = np.array((np.cos(azimuth), np.sin(azimuth))) * np.cos(height)
    dark, gloss = rng.uniform(0.03, 0.2), rng.uniform(0, 0.25) * (3 if style in ("gloss", "hard") else 1)
    wall, ambient, soft = rng.uniform(0.02, 0.4), rng.uniform(0.15, 0.6), rng.uniform(0.01, 0.06) * pitch
    strip, extent = rng.uniform(0.4, 0.6) * half, pitch * rng.uniform(4, 14) * np.array((rng.uniform(0.8, 1.4), 1))
    back, shine = rng.uniform(0.02, 0.5), rng.uniform(-0.5, 0.5, 2) * around * 0.5
    shine_wide = rng.uniform(0.1, 0.3) * around
    parity = 0 if made.step > 0 else 1  # of the rows on the face
    ray = view.rays(np.stack(np.meshgrid(np.arange(size[0]) + at[0], np.arange(size[1]) + at[1]), -1))
    face, ground = (
        view.place_mm[:2] + ray[..., :2] * ((z - view.place_mm[2]) / ray[..., 2])[..., None]
        for z in (max(0.0, -made.step), min(0.0, -made.step))
    )
    on_face = np.abs(face[..., 1] - made.nearest_row(face[..., 1], parity) * half) < strip
    groove = np.floor((face[..., 1] / half - parity) / 2)
    low, high = (2 * groove + parity) * half + strip, (2 * groove + 2 + parity) * half - strip
    on_wall = ~on_face & ((ground[..., 1] < low) | (ground[..., 1] > high))
    lit_from = ground[..., 1] + abs(made.step) * lamp[1] / np.sin(height)
    shaded = ~on_face & ((lit_from < low) | (lit_from > high))
    x, y = np.moveaxis(np.where(on_face[..., None], face, ground), -1, 0)
    white = np.where(on_face, made.cover(*np.moveaxis(face, -1, 0), parity, soft),
                     made.cover(*np.moveaxis(ground, -1, 0), 1 - parity, soft))  # fmt: skip
    lit = (dark + (0.85 - dark) * white) * (ambient + (1 - ambient) * np.where(shaded, 0.0, np.sin(height)))
    to_lamp = np.maximum(0, lamp[1] * np.where(ground[..., 1] < low, 1.0, -1.0))
    shone = gloss * np.exp(-((x - shine[0]) ** 2 + (y - shine[1]) ** 2) / 2 / shine_wide**2)
    light = np.where(on_wall, wall * (ambient * 0.7 + (1 - ambient) * to_lamp), lit + shone)
    behind = back * (1 + 0.2 * np.sin(x / pitch * 2.2) * np.cos(y / pitch * 1.3))
    return np.where((np.abs(x) > extent[0]) | (np.abs(y) > extent[1]), behind, light)


def _exposed(rng, light, style):
    """Frame of the light, through what stands before it, a lens and a sensor."""
    height, width = light.shape
    u, v = np.meshgrid(np.linspace(-0.5, 0.5, width), np.linspace(-0.5, 0.5, height))
    slope = rng.uniform(-0.8, 0.8, 2)
    light = light * np.clip(1 + slope[0] * u + slope[1] * v - rng.uniform(0, 1) * (u**2 + v**2), 0.1, None)
    if style in ("gloss", "hard"):
        for _ in range(2):
            at, wide = rng.uniform(-0.4, 0.4, 2), rng.uniform(0.03, 0.12)
            light = light + rng.uniform(0.2, 0.9) * np.exp(-((u - at[0]) ** 2 + (v - at[1]) ** 2) / 2 / wide**2)
    if style in ("covered", "hard"):
        hidden, share = np.zeros(light.shape, np.uint8), rng.uniform((0.2, 0.05, 0.2, 0.3), (0.45, 0.3, 0.6, 0.8))
        corner = ((0, 0), (share[0] * width, 0), (share[1] * width, share[2] * height), (0, share[3] * height))
        cv2.fillPoly(hidden, [np.array(corner).astype(int)], 1)
        top, aside, wide = rng.uniform(0.6, 0.9), rng.uniform(-0.2, 0.2), int(rng.uniform(0.01, 0.03) * width) + 1
        cv2.line(hidden, (int(top * width), 0), (int((top + aside) * width), height), 1, wide)
        hidden = cv2.GaussianBlur(hidden.astype(float), (0, 0), 2.0)
        light = light * (1 - hidden) + hidden * rng.uniform(0.05, 0.9)
    light = cv2.GaussianBlur(
        light, (0, 0), rng.uniform(0.5, 1.3) + (rng.uniform(1.5, 4) if style == "blur" else 0)
    )
    level = rng.uniform(0.04, 0.15) if style == "dim" else rng.uniform(0.5, 1.4)
    grey = light / np.percentile(light, 99) * 217.0 * level
    noise = rng.uniform(0.5, 3.0)
    grey += rng.normal(0, 1, grey.shape) * np.sqrt(noise**2 * 0.5 + np.maximum(grey, 0) * noise * 0.03)
    frame = np.clip(np.rint(grey + rng.uniform(0, 6)), 0, 255).astype(np.uint8)
    if rng.random() < 0.6:
        quality = [cv2.IMWRITE_JPEG_QUALITY, int(rng.uniform(60, 95))]
        frame = cv2.imdecode(cv2.imencode(".jpg", frame, quality)[1], 0)
    return frame
