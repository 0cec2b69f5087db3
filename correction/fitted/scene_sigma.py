"""Uncertainty of a fitted scene, in the tracer's own numbers, and of the points of the plane.

A fit gives a root of the covariance of its full vector, of what was free and of what was held (`with_considered`);
the tracer gives the derivative G of a landing point by the numbers of the scene (`tracer.strategies.sensitivity`;
rotations about the world's axes at the fitted pose).  With T = d numbers / d vector one matrix says everything:

    root = T root of the vector,   spread of a pixel's plane point = G root,   sigma^2 = sum of its squares.

Rows of `spread` at two pixels belong to the same draws.  Hence the sigma of the DIFFERENCE of two plane points is
the length of the difference of their spreads: what both share, such as a camera that stands 0.1 mm beside its
place, cancels.  The size of the target's squares is taken as exact.  What is not known of the target's light
(`correction.fit.solve.light`) is one more column of the root.  Particles lie in the light sheet: the same
uncertainty as seen there (`in_light_sheet`), and that of the sheet's own place, which moves all of the field
together; a sheet that the scene does not name is as unsure as one set up by eye (`Scene.lit`).

``scene.yaml`` is what the tracer reads.  The fit file keeps the rest:
the free numbers by name with values and covariance in their own units, every corner with its residual and the
smooth part of it, and what the test of the model says.
"""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, Field

from correction.fit.solve.ball_shape import SHAPES, balls_crossed, shape_rates
from correction.fit.solve.considered import ShapeRoot
from correction.fit.solve.unknowns import rotation_jacobian
from correction.maps.light_height import HeightRate
from ground.config import Table
from ground.errors import MapFileError
from ground.map_file import Hash, check_header, load_arrays, save_arrays
from ground.short_repr import short_repr
from tracer.errors import StaleMap
from tracer.harmonics import COUNT, NAMES, turning
from tracer.scene.scene import Scene, SceneBound
from tracer.strategies.branches import text_of
from tracer.strategies.sensitivity import CAMERA, SPHERE, TARGET, Landings, TargetPose, landings, parameter_names
from tracer.strategies.trace import name_keys

if TYPE_CHECKING:  # who reads a fit does not wait for all that makes one
    from correction.fit.judge.result import SceneFit

KIND = "scene fit"
BLOCK, ORDINARY_DRAWS = 65536, 64  # pixels at a time, fewer of beds: some 60 MB of derivatives


class FitHeader(Table):
    """Header of a fit file; a newer version may have written more."""

    model_config = ConfigDict(extra="allow")

    names: list[str]
    numbers: list[str] = Field(default_factory=list)
    scene_hash: Hash
    nominal_hash: Hash
    history: list[str]
    systematic_px: dict[str, Annotated[float, Field(ge=0.0, lt=1e6)]] = Field(default_factory=dict)
    shape_balls: list[str] = Field(default_factory=list)
    joint: str = ""
    common: Annotated[int, Field(ge=0)] = 0


@dataclass(frozen=True)
class SceneSigma(SceneBound):
    """Uncertainty of a fitted scene.

    Parameters
    ----------
    scene_hash : str
        Of the fitted scene.
    root : (Q, P) float64
        root root^T is the covariance of the scene's Q numbers: camera (14), then 5 of each sphere, then the rows
        of windows and tubes, then 45 of each ball out of round (`tracer.strategies.sensitivity`).
    systematic_px : dict
        Way through the glass ("" beside it) -> standard deviation of its own error, raw px per axis.
    plane_root : (6, K) float64
        The same of the plane's pose (`tracer.strategies.sensitivity.TARGET`); K = 0: it is the target's, which
        defines z = 0.
    numbers : tuple of str
        Names of the Q numbers; empty: there are only camera and spheres.
    shapes : ShapeRoot
        Of the shapes of balls that the scene takes for spheres.
    joint : (str, int)
        Key of a joint fit of several cameras, and number of the first columns of `root` that are the same draws in
        all of them.
    light : HeightRate or None
        Height of the traced light by that of the sheet, where the light passes bodies.
    """

    scene_hash: str
    root: NDArray[np.float64]
    systematic_px: dict[str, float] = field(default_factory=dict)
    plane_root: NDArray[np.float64] = field(default_factory=lambda: np.zeros((len(TARGET), 0)))
    numbers: tuple[str, ...] = ()
    shapes: ShapeRoot = field(default_factory=ShapeRoot)
    joint: tuple[str, int] = ("", 0)
    light: HeightRate | None = None
    noun: ClassVar[str] = "fit"
    cure: ClassVar[str] = "calibrate again"

    @classmethod
    def of(cls, fit: "SceneFit") -> "SceneSigma":
        """Uncertainty of the scene of a fit."""
        unknowns, full = fit.unknowns, fit.unknowns.full(fit.x)
        rows = unknowns.other_bodies.row_rates(full[unknowns.others], glass=True)
        shapes = fit.root[unknowns.all_shapes]
        root = np.concatenate((fit.root[: unknowns.glass.stop], rows @ fit.root[unknowns.others], shapes))
        root[3:6] = rotation_jacobian(full[3:6]) @ root[3:6]
        if fit.light.step.size:
            step = np.zeros(len(root))
            step[: len(fit.light.step)] = fit.light.step
            root = np.column_stack((root, step))
        of_shapes = fit.shapes.with_columns(1) if fit.light.step.size else fit.shapes
        known_as = parameter_names(fit.measured_scene)
        numbers = known_as[: unknowns.glass.stop + len(rows)] + unknowns.full_names[unknowns.all_shapes]
        numbers = numbers if len(rows) or len(shapes) else ()
        known = fit.verdict.systematic_px
        scene_hash = fit.measured_scene.content_hash()
        return cls(scene_hash, root, known, numbers=numbers, shapes=of_shapes, joint=fit.joint)

    @classmethod
    def load(cls, path: Path | str) -> "SceneSigma":
        """Read it from a fit file.

        Raises
        ------
        MapFileError
            The file is damaged, or of a version that did not store it.
        """
        header, arrays = load_arrays(path, KIND)
        said, root = check_header(path, header, FitHeader), arrays.get("scene_root")
        if root is None or root.dtype.str != "<f8" or root.ndim != 2 or not np.isfinite(root).all():
            raise MapFileError(f"{path}: does not hold the scene's uncertainty; run the calibration again")
        if said.numbers and len(said.numbers) != len(root):
            raise MapFileError(f"{path}: arrays do not fit together; run the calibration again")
        balls, of_shapes = tuple(said.shape_balls), arrays.get("shape_root", np.zeros((0, root.shape[1])))
        whole = of_shapes.dtype.str == "<f8" and of_shapes.shape == (len(SHAPES) * len(balls), root.shape[1])
        if not whole or not np.isfinite(of_shapes).all():
            raise MapFileError(f"{path}: arrays do not fit together; run the calibration again")
        shapes, joint = ShapeRoot(balls, of_shapes), (said.joint, min(said.common, root.shape[1]))
        numbers = tuple(said.numbers)
        return cls(said.scene_hash, root, said.systematic_px, numbers=numbers, shapes=shapes, joint=joint)

    def with_draw(self, change: NDArray[np.float64]) -> "SceneSigma":
        """Return the same with one standard deviation more: a change (Q,) of the scene's numbers."""
        return replace(self, root=np.column_stack((self.root, change)), shapes=self.shapes.with_columns(1))

    def in_light_sheet(self, scene: Scene) -> "SceneSigma":
        """Return the uncertainty of the scene as particles in its light sheet are seen (see `Scene`).

        Balls wholly behind a sheet inside a bed are no part of that view, and their numbers are not asked for.
        """
        root, axes = self.root.copy(), scene.lit.axes()
        for at in self._vectors():
            root[at : at + 3] = axes @ root[at : at + 3]
        for at, name in enumerate(self.numbers):
            if name.endswith(f".{NAMES[0]}"):
                root[at : at + COUNT] = turning(axes) @ root[at : at + COUNT]
        seen, numbers = scene.in_light_sheet(), self.numbers
        if len(seen.spheres) < len(scene.spheres):  # rows are then looked up by their names
            numbers = numbers or parameter_names(scene)[: -len(TARGET)]
        shapes = self.shapes.of_balls([sphere.name for sphere in seen.spheres]).rotate(axes)
        hashed, plane = seen.content_hash(), scene.lit.pose_root()
        return replace(
            self, scene_hash=hashed, root=root, plane_root=plane, numbers=numbers, shapes=shapes,
            light=HeightRate.of(seen),
        )  # fmt: skip

    def of_glass(self) -> "SceneSigma":
        """Return the same in a plane that is known exactly."""
        return replace(self, plane_root=np.zeros((len(TARGET), 0)))

    def _vectors(self) -> list[int]:
        """Columns at which three numbers in a row are the parts of one vector."""
        if self.numbers:
            return [at for at, name in enumerate(self.numbers) if name.endswith("x") and self._is_vector(at)]
        spheres = range(len(CAMERA), len(self.root), len(SPHERE))
        return [CAMERA.index("x"), CAMERA.index("rx"), *spheres]

    def _is_vector(self, at: int) -> bool:
        stem = self.numbers[at][:-1]
        return self.numbers[at + 1 : at + 3] == (f"{stem}y", f"{stem}z")

    def _rows(self, numbers: tuple[str, ...]) -> NDArray[np.float64]:
        """Root (Q', P) of those of the numbers that a scene without balls has as well.

        Raises
        ------
        StaleMap
            It is another scene.
        """
        if len(numbers) == len(self.root) and self.numbers in ((), numbers):
            return self.root
        if not self.numbers and len(numbers) == len(CAMERA):
            return self.root[: len(CAMERA)]
        if not set(numbers) <= set(self.numbers):
            raise StaleMap("the scene has not the spheres and walls of the fitted one; calibrate again")
        return self.root[[self.numbers.index(name) for name in numbers]]

    def spread(self, scene: Scene, pixels: NDArray[np.float64]) -> NDArray[np.float64]:
        """Spread (N, 2, P) [mm] of the plane points that raw pixels (N, 2) show; NaN where none is shown.

        Parameters
        ----------
        scene : Scene
            The fitted scene, or the same without its balls: then only camera, windows and tubes count.
        pixels : (N, 2) float64
            Acquired pixels.

        Raises
        ------
        StaleMap
            The scene has other bodies than the fitted one, and is not that without balls.
        """
        asked = np.isfinite(pixels).all(axis=1)
        rays = landings(scene, pixels[asked])
        rate = rays.rate[:, :, : -len(TARGET)]
        ways = self._ways(scene, pixels[asked], rays)
        known = rate @ self._rows(rays.names[: -len(TARGET)]) + self._of_shapes(scene, pixels[asked], ways)
        parts = [known, self._systematic(ways, rays)]
        by_plane = rays.rate[:, :, -len(TARGET) :] @ self.plane_root
        if self.light is not None:
            by_plane *= self.light.at(rays.point_mm)[:, None, None]
        parts.append(by_plane)
        found = np.full((len(pixels), 2, sum(part.shape[2] for part in parts)), np.nan)
        found[asked] = np.concatenate(parts, axis=2)
        return found

    def _ways(self, scene: Scene, pixels: NDArray[np.float64], rays: Landings) -> NDArray[np.str_]:
        """Spheres crossed by each ray (N,); empty where not needed."""
        if not (any(self.systematic_px.values()) or self.shapes.balls) or not len(pixels):
            return np.full(len(pixels), "")
        keys, firsts, which = np.unique(rays.key, return_index=True, return_inverse=True)
        directions = np.ascontiguousarray(scene.camera.directions(pixels[firsts]))
        origins = np.tile(np.array(scene.camera.position_mm), (len(firsts), 1))
        names = name_keys(scene, origins, directions, keys)
        return np.array([text_of(names[int(key)]) for key in keys])[which]

    def _of_shapes(
        self, scene: Scene, pixels: NDArray[np.float64], ways: NDArray[np.str_]
    ) -> NDArray[np.float64] | float:
        """Spread (N, 2, P) [mm] by the shapes of balls taken for spheres."""
        names = [sphere.name for sphere in scene.spheres]
        if not self.shapes.balls or not names:
            return 0.0
        if not set(self.shapes.balls) <= set(names):
            raise StaleMap("the scene has not the spheres of the fitted one; calibrate again")
        crossed = balls_crossed(ways, names)
        rates = shape_rates(scene.camera, scene.sphere_table(), crossed, pixels, TargetPose())
        return self.shapes.spread(names, rates)

    def _systematic(self, ways: NDArray[np.str_], rays: Landings) -> NDArray[np.float64]:
        """Spread (N, 2, 2 W) [mm] by the W ways' own errors."""
        if not any(self.systematic_px.values()) or not len(ways):
            return np.zeros((len(ways), 2, 0))
        out = np.zeros((len(ways), 2, 2 * len(self.systematic_px)))
        for number, (way, size) in enumerate(self.systematic_px.items()):
            here = ways == way
            out[here, :, 2 * number : 2 * number + 2] = size * rays.pixel_rate[here]
        # Too few corners to test: no better than the worst way that was tested.
        untested = (ways != "") & ~np.isin(ways, list(self.systematic_px))
        worst = max((size for way, size in self.systematic_px.items() if way), default=0.0)
        out[untested, :, :2] = worst * rays.pixel_rate[untested]
        return out

    def sigma(self, scene: Scene, pixels: NDArray[np.float64]) -> NDArray[np.float64]:
        """Standard deviation (N, 2) [mm] of the plane points that raw pixels (N, 2) show."""
        out = np.empty((len(pixels), 2))
        block = max(1, BLOCK // (1 + self.root.shape[1] // ORDINARY_DRAWS))
        for first in range(0, len(pixels), block):
            here = slice(first, first + block)
            out[here] = np.sqrt((self.spread(scene, pixels[here]) ** 2).sum(axis=2))
        return out


class VerdictHeader(FitHeader):
    """Verdict in the header of a fit file."""

    right: bool
    verdict: Annotated[list[str], Field(max_length=1000)]
    ways: Annotated[list[str], Field(max_length=100_000)]


@short_repr
@dataclass(frozen=True)
class StoredVerdict:
    """Verdict of a stored fit.

    Parameters
    ----------
    scene_hash : str
        Of the fitted scene.
    right : bool
        Whether nothing speaks against the model.
    sentences : tuple of str
        The verdict in words.
    ways : tuple of str
        Ways through the glass that corners are seen on; empty for the direct view.
    way : (N,) int64
        Number of the way of every corner.
    pixel, smooth_px : (N, 2) float64
        Where corners were measured, and the smooth part of their residuals, raw px.
    """

    scene_hash: str
    right: bool
    sentences: tuple[str, ...]
    ways: tuple[str, ...]
    way: NDArray[np.int64]
    pixel: NDArray[np.float64]
    smooth_px: NDArray[np.float64]

    @classmethod
    def of(cls, fit: "SceneFit") -> "StoredVerdict":
        """Return the part of a verdict that `save_fit` stores."""
        ways, way = np.unique(fit.corners.branch_name, return_inverse=True)
        verdict, scene_hash = fit.verdict, fit.measured_scene.content_hash()
        names = tuple(map(str, ways.tolist()))
        return cls(
            scene_hash, verdict.is_right, verdict.sentences, names, way, fit.corners.pixel, verdict.smooth_px
        )


def save_fit(path: Path | str, fit: "SceneFit") -> None:
    """Write a fit, atomically.

    Header: ``names``, ``numbers``, ``scene_hash``, ``nominal_hash``, ``frames``, ``history``,
    ``systematic_px`` (way -> its own error), ``shape_balls`` (`ShapeRoot`), ``right``, ``verdict`` and ``ways``
    (`StoredVerdict`), of a joint fit ``joint`` and ``common`` (`SceneSigma`).  Arrays:
    ``values`` (P,), ``covariance`` (P, P) in the units of the names, ``scene_root`` (Q, R) (see `SceneSigma`),
    ``shape_root`` (5 B, R),
    ``corner_frame``, ``corner_way`` (N,), ``corner_index`` (N, 2), ``corner_px``, ``residual_px``, ``smooth_px``
    (N, 2), ``behind``, ``inlier`` (N,).
    """
    unit, corners, found = fit.unknowns.sigma, fit.corners, StoredVerdict.of(fit)
    sigma = SceneSigma.of(fit)
    header = {
        "names": list(fit.names),
        "numbers": list(sigma.numbers),
        "scene_hash": found.scene_hash,
        "nominal_hash": fit.unknowns.scene.content_hash(),
        "frames": list(fit.frames),
        "history": [str(step) for step in fit.history],
        "systematic_px": fit.verdict.systematic_px,
        "shape_balls": list(sigma.shapes.balls),
        "right": found.right,
        "verdict": list(found.sentences),
        "ways": list(found.ways),
    }
    if sigma.joint[1]:
        header |= {"joint": sigma.joint[0], "common": sigma.joint[1]}
    arrays = {
        "values": fit.values,
        "covariance": fit.covariance * np.outer(unit, unit),
        "scene_root": sigma.root,
        "shape_root": sigma.shapes.root,
        "corner_frame": corners.frame.astype(np.int32),
        "corner_way": found.way.astype(np.int32),
        "corner_index": corners.index.astype(np.int32),
        "corner_px": corners.pixel,
        "residual_px": corners.residual_px,
        "smooth_px": found.smooth_px,
        "behind": corners.behind.astype(np.uint8),
        "inlier": corners.inlier.astype(np.uint8),
    }
    save_arrays(path, KIND, header, {name: np.ascontiguousarray(array) for name, array in arrays.items()})


def load_verdict(path: Path | str) -> StoredVerdict:
    """Read what a fit file says of the model.

    Raises
    ------
    MapFileError
        The file is damaged, or of a version that did not store it.
    """
    header, arrays = load_arrays(path, KIND)
    if not {"verdict", "ways"} <= header.keys():
        raise MapFileError(f"{path}: does not hold the test of its model; run the calibration again")
    said = check_header(path, header, VerdictHeader)
    way, pixel, smooth = (arrays.get(name) for name in ("corner_way", "corner_px", "smooth_px"))
    if way is None or pixel is None or smooth is None:
        raise MapFileError(f"{path}: does not hold the test of its model; run the calibration again")
    known = way.dtype.str == "<i4" and way.ndim == 1 and bool(np.all((way >= 0) & (way < len(said.ways))))
    places = all(one.dtype.str == "<f8" and one.shape == (*way.shape, 2) for one in (pixel, smooth))
    if not known or not places or not np.isfinite([pixel, smooth]).all():
        raise MapFileError(f"{path}: arrays do not fit together; run the calibration again")
    number = way.astype(np.int64)
    return StoredVerdict(said.scene_hash, said.right, tuple(said.verdict), tuple(said.ways), number, pixel, smooth)
