"""Frames of a flow: pairs of pictures of one sheet of particles through glass, with background and noise.

    scene = demo_scene("two_spheres_500")
    for first, second in render_pairs(scene, Flow(Jet()), dt_s=500e-6, count=10):
        ...

A pair is a pure function of its number: made alone, in another order or in another process it has the same bits,
so a thousand pairs can be made on all cores by `benchmarks.flow`.  Defaults are the paper's: 12 bit, floor 30 to
40 counts, particles of a few dozen to 300 counts, 0.03 per pixel, a sheet of 1 mm.
"""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim.flow.fields import Flow
from sim.flow.particles import LightSheet, ParticlePair, SeededArea, Seeding, outside, particle_pair
from sim.flow.reflections import Reflections
from sim.flow.sheet_light import light_reach_mm, trace_sheet
from sim.flow.view import STEP_PX, ParticleView
from sim.renderer.render import Aperture
from sim.renderer.sensor import Sensor
from tracer.bodies import Sphere
from tracer.errors import SceneError
from tracer.light_sheet import SheetSource
from tracer.scene.scene import Scene

Frame = NDArray[np.uint16]

SLAB = 0.25  # thicknesses of the sheet: depth that shares a plane where balls cross the sheet
BRIGHT_DEPTH = 0.5  # thicknesses to either side of the middle in slabs; the outer ones hold the rest
FLOW_SENSOR = Sensor(white_counts=1.0, read_noise_counts=2.0, offset_counts=35.0, blur_px=0.0)


class Flashed(NamedTuple):
    """A flash within an exposure: its pair, pulse 0 (A) or 1 (B), time since pulse A, and the time of A."""

    pair: int
    pulse: int
    since_first_s: float
    time_s: float


@dataclass(frozen=True)
class FlowCamera:
    """A camera that looks at a flow.

    Parameters
    ----------
    scene : Scene
        Camera and glass, as they truly are. If its sheet has sources, the light of `sheet` comes from there,
        through the bodies; otherwise it is even.
    flow : Flow
        What moves the particles.
    sheet, seeding, reflections, sensor
        Light, particles, what stands still, and the sensor, whose irradiance is counted in counts.
    particle_counts : float
        On the brightest pixel of an average particle in the middle of the sheet, seen without glass.
    aperture : Aperture, optional
        A finite pupil; None is a pinhole.
    points_of_pupil : int
        7, 19, ...
    spot_px : float
        Diameter (e^-2) of a particle's image by diffraction.
    step_px : float
        Edge of a cell of the ray grid; images lie where rays say, whatever it is.
    margin_mm : float
        Seeded beyond the view; particles that go further between pulses leave an empty edge.
    seed : int
        Of particles and noise.
    noise_seed : int, optional
        Of noise, if another than that of particles.
    cameras : callable
        Gives all cameras of this flow and seed, this one among them: all see the same particles, those of the area
        that holds what any of them sees.  Asked at the first frame with particles; none: this one is alone.
    """

    scene: Scene
    flow: Flow
    sheet: LightSheet = field(default_factory=LightSheet)
    seeding: Seeding = field(default_factory=Seeding)
    reflections: Reflections | None = field(default_factory=Reflections)
    sensor: Sensor = FLOW_SENSOR
    particle_counts: float = 70.0
    aperture: Aperture | None = None
    points_of_pupil: int = 7
    spot_px: float = 2.4
    step_px: float = STEP_PX
    margin_mm: float = 2.0
    seed: int = 0
    noise_seed: int | None = None
    cameras: "Callable[[], Sequence[FlowCamera]]" = tuple

    def __post_init__(self) -> None:
        if not self.particle_counts >= 0.0:
            raise SceneError("particle_counts must not be negative")

    def pair(self, number: int, dt_s: float, time_s: float, *, is_seeded: bool = True) -> tuple[Frame, Frame]:
        """Frames (H, W) of pulses A and B.

        Parameters
        ----------
        number : int
            Of the pair: another number has other particles and other noise.
        dt_s : float
            Time between the pulses.
        time_s : float
            Of pulse A, in the flow's own time.
        is_seeded : bool
            False gives what stands still alone: a background frame.
        """
        particles = self.particles(number, dt_s, time_s) if is_seeded else None

        def frame(pulse: int) -> Frame:
            return self._frame(number, pulse, particles)

        with ThreadPoolExecutor(2) as both:
            first, second = both.map(frame, (0, 1))
        return first, second

    def expose_flashes(self, lit: Sequence["Flashed"], *, is_seeded: bool = True) -> Frame:
        """A frame (H, W) of an exposure that holds these flashes."""
        light = np.zeros(self.scene.camera.shape, np.float32)
        for flash in lit:
            light += self._still(flash.pulse)
            if is_seeded:
                particles = self.particles(flash.pair, flash.since_first_s, flash.time_s)
                light += self._particle_light(particles, flash.pulse)
        first = lit[0]
        return self.sensor.expose(light, seed=self._seed(first.pair, first.pulse))

    def dark(self, number: int, pulse: int = 0) -> Frame:
        """A frame (H, W) without light."""
        light = np.zeros(self.scene.camera.shape, np.float32)
        return self.sensor.expose(light, seed=self._seed(number, 10 + pulse))

    def particles(self, number: int, dt_s: float, time_s: float) -> ParticlePair:
        """The particles of a pair."""
        found = particle_pair(
            self.flow,
            self._light,
            self.seeding,
            area=self._area,
            time_s=time_s,
            dt_s=dt_s,
            rng=np.random.default_rng(_hash_seed(self.seed, number, 2)),
        )
        if self._spheres_in_sheet:  # no particle is in glass
            first, second = (
                light * outside(self._spheres_in_sheet, places)
                for light, places in zip(found.light, found.places_mm, strict=True)
            )
            found = replace(found, light=(first, second))
        return found

    def slopes(self, pixels: NDArray[np.float64]) -> NDArray[np.float64]:
        """Slopes dx/dz, dy/dz (N, 2) of the rays of pixels (N, 2) where they cross the plane; NaN for none."""
        return self._view.slopes(pixels)

    def trace_view(self) -> None:
        """Trace the rays now, and not with the first frame."""
        _ = self._view

    @property
    def own_area(self) -> SeededArea:
        """The area that this camera sees, with its margin."""
        low, high = self._view.corners_mm
        return SeededArea(np.array([low - self.margin_mm, high + self.margin_mm]), self.px_mm)

    @property
    def px_mm(self) -> float:
        """Width that a pixel sees without glass."""
        return float(self.scene.camera.position_mm[2]) / self.scene.camera.focal_px

    def _frame(self, number: int, pulse: int, particles: ParticlePair | None) -> Frame:
        light = self._still(pulse)
        if particles is not None:
            light = light + self._particle_light(particles, pulse)
        return self.sensor.expose(light, seed=self._seed(number, pulse))

    def _particle_light(self, particles: ParticlePair, pulse: int) -> NDArray[np.float32]:
        """Counts (H, W) of particles."""
        places, shine = particles.places_mm[pulse], particles.light[pulse]
        slab = np.searchsorted([view.heights_mm[0] for view in self._views[1:]], places[:, 2])
        seen = np.zeros(self.scene.camera.shape, np.float32)
        for number, view in enumerate(self._views):
            seen += view.light(places[slab == number], shine[slab == number])
        return np.asarray(np.float32(self.particle_counts / self._view.peak()) * seen)

    def _seed(self, number: int, what: int) -> int:
        return _hash_seed(self.seed if self.noise_seed is None else self.noise_seed, number, what)

    @property
    def _sources(self) -> tuple[SheetSource, ...]:
        return () if self.scene.sheet is None else self.scene.sheet.sources

    @property
    def _area(self) -> SeededArea:
        """Area that any camera of the bench sees."""
        return SeededArea.around([camera.own_area for camera in self.cameras() or (self,)])

    @cached_property
    def _light(self) -> LightSheet:
        """The sheet as bodies leave it, traced once for all pairs; as it is if its sources are not known."""
        return (
            trace_sheet(self.scene, self.sheet, self._sources, self._area.corners_mm)
            if self._sources
            else self.sheet
        )

    @property
    def _view(self) -> ParticleView:
        """The rays to the middle of the sheet."""
        return self._views[len(self._views) // 2]

    @cached_property
    def _views(self) -> tuple[ParticleView, ...]:
        """The rays, traced once for all pairs, from the lowest slab of the depth to the highest.

        A tilted sheet needs a greater depth.  Where balls cross it, a ray that is in glass at one height may have
        met light above it, so that each slab has a plane of its own, the middle one that of the sheet.
        """
        height, width = self.scene.camera.shape
        tilt = 0.7 * max(height, width) * self.px_mm * (abs(self.sheet.slope_x) + abs(self.sheet.slope_y))
        reach = (light_reach_mm(self.sheet) if self._sources else self.sheet.reach_mm) + tilt
        middle = self.sheet.offset_mm
        low, high = middle - reach, middle + reach
        planes, edges = [0.0], [min(low, -0.01), max(high, 0.01)]
        if self._spheres_in_sheet:
            step = SLAB * self.sheet.thickness_mm
            count = int(np.ceil((BRIGHT_DEPTH * self.sheet.thickness_mm + tilt) / step))
            planes = [middle + step * each for each in range(-count, count + 1)]
            edges = [low, *(each - 0.5 * step for each in planes[1:]), high]
        return tuple(
            ParticleView(
                self.scene,
                (edges[number], edges[number + 1]),
                plane_mm=plane,
                aperture=self.aperture,
                points_of_pupil=self.points_of_pupil,
                spot_px=self.spot_px,
                step_px=self.step_px,
            )
            for number, plane in enumerate(planes)
        )

    @cached_property
    def _spheres_in_sheet(self) -> tuple[Sphere, ...]:
        """The balls that the sheet runs through; one that it only grazes counts as beside it."""
        return tuple(
            ball
            for ball in Sphere.among(self.scene.bodies)
            if abs(ball.centre_mm[2] - self.sheet.offset_mm) < ball.radius_mm - self.sheet.thickness_mm
        )

    @cached_property
    def _stills(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        if self.reflections is None:
            nothing = np.zeros(self.scene.camera.shape, np.float32)
            return nothing, nothing
        first, second = (self.reflections.light(self.scene, self.sheet, pulse) for pulse in (0, 1))
        return first, second

    def _still(self, pulse: int) -> NDArray[np.float32]:
        return self._stills[pulse]


def _hash_seed(seed: int, number: int, what: int) -> int:
    return int(np.random.SeedSequence((seed, number, what)).generate_state(1, np.uint64)[0])


def render_pairs(
    scene: Scene,
    flow: Flow,
    *,
    dt_s: float,
    count: int,
    rate_hz: float = 10.0,
    first: int = 0,
    seed: int = 0,
    camera: FlowCamera | None = None,
) -> Iterator[tuple[Frame, Frame]]:
    """Yield pairs of frames (A, B), uint16 (H, W), of a flow behind glass.

    Parameters
    ----------
    scene : Scene
        Camera and glass as they truly are.
    flow : Flow
        The flow.
    dt_s : float
        From A to B.
    count : int
        How many pairs.
    rate_hz : float
        Of the pairs: pair i is taken at i / rate_hz.
    first : int
        Number of the first pair; the same number gives the same bits.
    seed : int
        Of particles and noise.
    camera : FlowCamera, optional
        Light, seeding, aperture and sensor other than the defaults; its scene, flow and seed count then.
    """
    made = camera or FlowCamera(scene, flow, seed=seed)
    for number in range(first, first + count):
        yield made.pair(number, dt_s, number / rate_hz)
