"""The world of a simulated bench: where everything really is, and what the sensor would see of it.

The world knows three elements: camera, glass, target.  Motors carry them, with play, lead error and whole steps,
so an element stands where its screw has really brought it, not where a controller says.  Pictures are rendered at
these TRUE places, with a camera, glass and aim that are all a little off the scene file (`misaligned`, by the
seed): what a bench does to an experimenter.  The target's plane is z = 0 of the scene; a chessboard hangs there in
the light that the scene file tells of target frames (`sim.light`).
"""

import secrets
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from daq.bench.bench_table import Bench
from sim.arranged import arrange, sheet_mm, true_scene
from sim.bench_table import SimulationTable
from sim.flow.images import FlowCamera
from sim.frame_truth import WORLDS, FrameTruth, with_truth
from sim.light import Colours, LitFlow, colours_of, in_each_colour, target_light
from sim.renderer.patterns import Chessboard, CodedBoard, DotGrid, ParticleSheet, Plate, place, print_particles
from sim.renderer.render import render_irradiance
from sim.renderer.sensor import Sensor
from sim.stages import SimulatedStages
from sim.timing import SimulatedTiming
from tracer.board import Board
from tracer.scene.fit_section import FitTable
from tracer.scene.scene import Scene
from tracer.scene.scene_file import dump_scene

PRINT_MARGIN = 1.5  # glass looks past the edge of the bare view
KEPT_VIEWS = 4
PRINTER = 7  # what is drawn for the printer is drawn by this beside the seed
KEPT_FLOW_VIEWS = 2  # the glass in and out
LATER_S = 1.0  # in the flow for each exposure that was made before this process began
BOARD = "chessboard"  # what a target run shows
FLOW = "flow"  # what a flow run shows: no print, but light on particles
Print = Chessboard | CodedBoard | DotGrid | ParticleSheet | Plate


class DrawingTime:
    """Seconds in which at least one picture was drawn; the worlds of several cameras share one.

    A real camera has its picture when the shutter closes; ours has to draw it first, with rays, for a second or
    for minutes.  This is time of the computer and of no camera: a timeout of a wait for a frame takes it off what
    has passed.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._drawing, self._since_s, self._sum_s = 0, 0.0, 0.0

    @contextmanager
    def count(self) -> Iterator[None]:
        """Count the block as drawing."""
        with self._lock:
            if not self._drawing:
                self._since_s = time.monotonic()
            self._drawing += 1
        try:
            yield
        finally:
            with self._lock:
                self._drawing -= 1
                if not self._drawing:
                    self._sum_s += time.monotonic() - self._since_s

    @property
    def so_far_s(self) -> float:
        """All of it until now, what is being drawn included."""
        with self._lock:
            return self._sum_s + (time.monotonic() - self._since_s if self._drawing else 0.0)


class World:
    """True places of everything, and the images that a sensor has of it; a `FrameSource`.

    Parameters
    ----------
    bench : Bench
        Nominal scene, and which axis carries what.
    table : SimulationTable
        Seed and screws.
    stages : SimulatedStages
        Every axis.
    shows : str
        Object on the target's stage.
    exposures_before : int
        Exposures made before this process began.
    first : World, optional
        As the first camera sees it: both see the same light on the same particles.
    noise_seed : int, optional
        Of the sensor's noise, if another than the table's seed.
    """

    def __init__(
        self,
        bench: Bench,
        table: SimulationTable,
        stages: SimulatedStages,
        shows: str,
        exposures_before: int,
        first: "World | None" = None,
        noise_seed: int | None = None,
    ) -> None:
        self._worlds: list[World] = [] if first is None else first._worlds  # of all cameras
        self._worlds.append(self)
        self.drawing: DrawingTime = DrawingTime() if first is None else first.drawing
        self.timing: list[SimulatedTiming] = []  # units that have power; devices connected to one listen to it
        self._bench = bench
        self._table = table
        self._stages = stages
        self._exposures = exposures_before
        self.scene = true_scene(bench, table)
        # More pairs were lit than kept: numbers and time begin well behind them.
        self.lit: LitFlow | None = None if first is None else first.lit
        if first is None and shows == FLOW:
            self.lit = LitFlow(exposures_before, LATER_S * exposures_before)
        self.print = print_of(bench, table.seed, shows)
        self.lamp = target_light(bench) if shows == BOARD else None  # particles are lit by the laser
        self._colours: Colours = ((self.scene.wavelength_nm, 1.0),)
        if self.lamp is not None:
            self._colours = colours_of(self.lamp.light(self.scene.wavelength_nm))
        self._sensor = Sensor(blur_px=table.blur_px)
        self._views: dict[tuple[float, ...], NDArray[np.float32]] = {}
        self._flow_cameras: dict[tuple[float, ...], FlowCamera] = {}
        self._number = table.seed % WORLDS if table.keeps else secrets.randbelow(WORLDS)
        self._noise_seed = table.seed if noise_seed is None else noise_seed
        self._lock = threading.Lock()
        self._views_lock: threading.RLock = threading.RLock() if first is None else first._views_lock
        self._dimmed = 1.0
        self.on_exposed: Callable[[int, NDArray[np.uint16], dict[str, float]], None] | None = None

    def true_mm(self) -> dict[str, float]:
        """Return the true position of every axis, in its own coordinate."""
        return {name: self._stages.true_mm(name) for name in self._bench.table.stages.axes}

    def dim(self, share: float) -> None:
        """Leave this share of its light to the target from now on; of a flow the light is the laser's."""
        self._dimmed = share

    def frame(self, trigger_index: int, time_ns: int) -> NDArray[np.uint16]:
        """One exposure of the world as it stands (H, W) uint16."""
        with self.drawing.count(), self._lock:
            true_mm = self.true_mm()
            light = self._light(true_mm) * np.float32(self._dimmed)
            image = self._sensor.expose(light, seed=self._noise_seed * 1_000_003 + self._exposures)
            return self._keep(trigger_index, image, true_mm)

    def expose(self, trigger_index: int, start_ns: int, end_ns: int) -> NDArray[np.uint16]:
        """One exposure (H, W) uint16; a flow is seen by the light that falls while the shutter is open."""
        if self.lit is None:
            return self.frame(trigger_index, start_ns)
        with self.drawing.count(), self._lock:
            true_mm = self.true_mm()
            image = self.lit.expose(self._flow_camera(true_mm), start_ns, end_ns)
            return self._keep(trigger_index, image, true_mm)

    def _keep(
        self, trigger_index: int, image: NDArray[np.uint16], true_mm: dict[str, float]
    ) -> NDArray[np.uint16]:
        """Count and report an exposure; print the truth into its image where the bench file wants it."""
        number, self._exposures = self._exposures, self._exposures + 1
        if self.on_exposed is not None:
            self.on_exposed(number, image, true_mm)
        if not self._table.prints_truth:
            return image
        truth = FrameTruth(trigger_index, number, true_mm, self._stages.is_moving, self._number)
        return with_truth(image, truth, self._sensor.bits)

    def _flow_camera(self, true_mm: Mapping[str, float]) -> FlowCamera:
        """The camera that looks at the flow from where it stands."""
        key = tuple(true_mm.values())
        with self._views_lock:
            if key not in self._flow_cameras:
                while len(self._flow_cameras) >= KEPT_FLOW_VIEWS:
                    self._flow_cameras.pop(next(iter(self._flow_cameras)))
                scene, _ = self._arrange(true_mm)
                camera = self._table.flow.camera(scene, self._table.seed, self._table.pupil)
                others = partial(self._all_flow_cameras, dict(true_mm))
                self._flow_cameras[key] = replace(camera, noise_seed=self._noise_seed, cameras=others)
            return self._flow_cameras[key]

    def _all_flow_cameras(self, true_mm: Mapping[str, float]) -> list[FlowCamera]:
        """Every camera that looks at the flow, while axes stand there."""
        with self._views_lock:  # each view is traced once, whichever camera asks first
            cameras = [world._flow_camera(true_mm) for world in self._worlds]
            for camera in cameras:
                camera.trace_view()
            return cameras

    def light(self) -> NDArray[np.float32]:
        """The light of the world as it stands on each pixel, float32 (H, W): 1 = white sheet without glass."""
        with self._lock:
            return self._light(self.true_mm())

    def truth(self) -> str:
        """The true scene as a scene file, with the light of the target if that is what was shown."""
        return dump_scene(self.scene, None if self.lamp is None else FitTable(light=self.lamp))

    def flow_truth(self) -> str:
        """Every number of the flow as YAML, in the words of `simulation.flow`."""
        return self._table.flow.as_text(self._table.seed, self.scene)

    def _light(self, true_mm: Mapping[str, float]) -> NDArray[np.float32]:
        key = tuple(true_mm.values())
        if key not in self._views:
            while len(self._views) >= KEPT_VIEWS:
                self._views.pop(next(iter(self._views)))
            scene, pattern = self._arrange(true_mm)
            light = np.zeros(scene.camera.shape, np.float32)
            for coloured, share in in_each_colour(scene, self._colours):
                light += np.float32(share) * render_irradiance(
                    coloured,
                    pattern,
                    samples=self._table.samples,
                    seed=self._table.seed,
                    aperture=self._table.pupil,
                    sheet_mm=sheet_mm(self._bench),
                )
            across = np.linspace(-1.0, 1.0, light.shape[1], dtype=np.float32)
            self._views[key] = light * (np.float32(1.0) + np.float32(self._table.uneven_light) * across)
        return self._views[key]

    def _arrange(self, true_mm: Mapping[str, float]) -> tuple[Scene, Print]:
        """Scene and print at the true places of their carriages."""
        scene, pose = arrange(self._bench, self.scene, true_mm, self._table.glass_off_mm)
        return scene, place(self.print, pose)


def _board_of(bench: Bench, seed: int) -> Chessboard | CodedBoard | DotGrid | Plate:
    """The board on paper, as large as its printer has made it: what was measured of it is not quite that.

    A plain board hangs either way round: which of its squares are bright is not specified.
    """
    board, rng = bench.board, np.random.default_rng((seed, PRINTER))
    x, y = (s + sigma * rng.standard_normal() for s, sigma in zip(board.scale, board.scale_sigma, strict=True))
    on_paper = Board(
        board.square_mm, board.disc_mm, discs=board.discs, squares=board.squares,
        origin_corner=board.origin_corner, codes=board.codes, dots=board.dots, scale=(x, y),
        staggered=board.staggered,
        odd_bright=bool(rng.integers(2)) if board.is_plain else True,
    )  # fmt: skip
    if board.dots is not None and board.dots.levels:
        step = board.dots.step_mm + board.step_sigma_mm * rng.standard_normal()
        return Plate(**vars(replace(on_paper, dots=replace(board.dots, step_mm=step))))
    if board.dots is not None:
        return DotGrid(**vars(on_paper))
    return (Chessboard if board.codes is None else CodedBoard)(**vars(on_paper))


def print_of(bench: Bench, seed: int, shows: str) -> Print:
    """Return the object on the target's stage."""
    if shows == BOARD:
        return _board_of(bench, seed)
    camera = bench.scene.camera
    px_per_mm = camera.focal_px / float(np.linalg.norm(camera.position_mm))
    width_mm, height_mm = (PRINT_MARGIN * side / px_per_mm for side in camera.sensor_px)
    return print_particles((width_mm, height_mm), px_per_mm, seed=seed)
