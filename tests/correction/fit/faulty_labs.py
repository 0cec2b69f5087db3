"""Photographed labs with one fault each, of every kind that people make, and what must be said of it.

Two or three balls of several glasses, small sensors, cameras that look from the side.  A fault is in what the
scene file says, in what was done between frames, or in what stands in the view.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

from correction.fit.seen.measurement import TargetFrame
from correction.fit.seen.prediction import square_behind_px
from correction.target import Chessboard
from sim.demo.scenes import misalign
from sim.renderer.patterns import Chessboard as Print
from sim.renderer.patterns import Pose, place
from sim.renderer.render import render
from sim.renderer.sensor import Sensor
from tracer.bodies import Rod, Sphere
from tracer.camera import Camera, Lens, look_at
from tracer.errors import SceneError
from tracer.media import ConstantMedium
from tracer.scene.fit_section import FitCameraTable, FitNamedTable, FitTable
from tracer.scene.scene import Scene
from tracer.strategies.sensitivity import TargetPose

SENSORS_PX = ((640, 480), (720, 560), (560, 560), (600, 720))
VIEW_MM, AWAY = (40.0, 150.0), (3.2, 7.0)  # width of the view, and distance in widths
HEIGHTS = (-0.12, 0.12)  # of the target, in widths of the view, where there are several
WIDE_PX = 12.0  # squares behind glass, or nothing is to be seen there


@dataclass(frozen=True)
class Case:
    """A lab before it is fitted.

    Parameters
    ----------
    given : Scene
        As the file says.
    bare, glass : Scene
        What stood there when the frames were taken.
    board, printed : Chessboard
        The target as described, and as it is.
    words : tuple of str
        Of these one must be among the words of the verdict or refusal.
    priors : FitTable
    named_mm : tuple of (float, float)
        Heights as named and as they were, beside 0.
    spoil : callable
        Changes the image of a frame, bare or with glass.
    pose : Pose
        Of the target when the frames with glass were taken.
    """

    given: Scene
    bare: Scene
    glass: Scene
    board: Chessboard
    printed: Chessboard
    words: tuple[str, ...] = ()
    priors: FitTable = field(default_factory=FitTable)
    named_mm: tuple[tuple[float, float], ...] = ()
    spoil: Callable[[np.ndarray, bool], np.ndarray] = lambda image, glass: image
    pose: Pose = field(default_factory=Pose)

    def frames(self, seed: int) -> list[TargetFrame]:
        """Photograph them."""
        found = []
        for glass in (False, True):
            for named, true in ((0.0, 0.0), *(self.named_mm if not glass else ())):
                scene = self.glass if glass else self.bare.bare()
                at = self.pose if glass else Pose((0.0, 0.0, true))
                print_ = place(Print(self.printed.square_mm, self.printed.disc_mm), at)
                image = self.spoil(render(scene, print_, Sensor(), samples=3, seed=7 * seed + len(found)), glass)
                found.append(
                    TargetFrame(f"target_{'glass' if glass else 'clear'}_z{named:+g}mm", image, glass, named)
                )
        return found


@cache
def right(seed: int) -> Case:
    """A lab without a fault."""
    rng = np.random.default_rng((5600, seed))
    while True:
        size = SENSORS_PX[rng.integers(len(SENSORS_PX))]
        view = float(np.exp(rng.uniform(*np.log(VIEW_MM))))
        away, height = view * float(rng.uniform(*AWAY)), view * size[1] / size[0]
        side_x, side_y = (away * np.tan(np.deg2rad(rng.uniform(-5.0, 5.0, 2)))).tolist()
        at = (side_x, side_y, away)
        pose = look_at(at, (0.0, 0.0, 0.0), float(rng.uniform(-0.1, 0.1)))
        middle = (0.5 * (size[0] - 1), 0.5 * (size[1] - 1))
        camera = Camera(size[0] * away / view, middle, size, at, pose)
        glasses = [ConstantMedium(float(n)) for n in rng.uniform(1.4, 1.7, 2)]
        balls = _balls(rng, view, height, glasses)
        try:
            nominal = Scene(camera, tuple(balls))
            truth = misalign(nominal, int(rng.integers(1 << 30)))
        except SceneError:
            continue
        square = float(rng.uniform(14.0, 22.0)) * view / size[0]
        board = Chessboard(square, 0.4 * square)
        if square_behind_px(nominal, TargetPose(), board) > WIDE_PX:
            return Case(nominal, truth, truth, board, board)


def _balls(rng: np.random.Generator, view: float, height: float, glasses: list[ConstantMedium]) -> list[Sphere]:
    """Two or three that touch nothing, one before another now and then."""
    side, balls = min(view, height), list[Sphere]()
    while len(balls) < 2:
        balls = []
        for number in range(rng.integers(2, 4)):
            for _ in range(100):
                radius = float(rng.uniform(0.16, 0.26) * side)
                x, y = (rng.uniform(-0.28, 0.28, 2) * (view, height)).tolist()
                before = float(rng.uniform(0.0, 0.7) * side) * float(rng.random() < 0.4)
                z = radius + 0.015 * view + before
                away = [np.linalg.norm(np.subtract((x, y, z), b.centre_mm)) - b.radius_mm for b in balls]
                if min(away, default=np.inf) > radius + 0.01 * view:
                    balls.append(Sphere(f"ball{number}", (x, y, z), radius, glasses[rng.integers(2)]))
                    break
    return balls


def _changed(scene: Scene, name: str, **by: object) -> Scene:
    return scene.with_bodies([replace(s, **by) if s.name == name else s for s in scene.spheres])  # type: ignore[arg-type]


def _ball(case: Case, rng: np.random.Generator) -> Sphere:
    """One ball of the lab, the one seen foremost more often."""
    balls = sorted(case.given.spheres, key=lambda ball: -ball.centre_mm[2])
    return balls[0] if rng.random() < 0.6 else balls[-1]


def _radius(low: float, high: float) -> Callable[[Case, np.random.Generator], Case]:
    def change(case: Case, rng: np.random.Generator) -> Case:
        ball, share = _ball(case, rng), float(rng.uniform(low, high))
        x, y, z = ball.centre_mm
        grown = ball.radius_mm * (1.0 + share)
        wrong = _changed(case.given, ball.name, radius_mm=grown, centre_mm=(x, y, max(z, grown + 0.05)))
        return replace(case, given=wrong, words=(rf"radius\D+{ball.name}", rf"{ball.name}\W.*radius"))

    return change


def _index(sigma: float, low: float, high: float) -> Callable[[Case, np.random.Generator], Case]:
    def change(case: Case, rng: np.random.Generator) -> Case:
        ball, off = _ball(case, rng), float(rng.uniform(low, high) * rng.choice([-1.0, 1.0]))
        assert isinstance(ball.medium, ConstantMedium)
        glass = ConstantMedium(ball.medium.index + off)
        given = case.given.with_bodies(
            [replace(s, medium=glass) if s.medium == ball.medium else s for s in case.given.spheres]
        )
        words = (
            r"\.n was given",
            r"\.n was held",
            "glass was held",
            r"radius, glass",
            r"\.n had to move",
            "glass",
        )
        return replace(case, given=given, priors=FitTable(n=sigma), words=words)

    return change


def _stray(low: float, high: float) -> Callable[[Case, np.random.Generator], Case]:
    def change(case: Case, rng: np.random.Generator) -> Case:
        eye = np.array(case.glass.camera.position_mm)
        while True:
            ball = case.glass.spheres[rng.integers(len(case.glass.spheres))]
            at, radius = np.array(ball.centre_mm), ball.radius_mm * float(rng.uniform(low, high))
            towards = (eye - at) / np.linalg.norm(eye - at)
            aside = rng.normal(size=3)
            aside -= towards * (aside @ towards)
            aside *= float(rng.uniform(0.0, 1.2)) * ball.radius_mm / np.linalg.norm(aside)
            x, y, z = (at + (ball.radius_mm + 1.5 * radius + 1.0) * towards + aside).tolist()
            try:
                glass = ConstantMedium(float(rng.uniform(1.33, 1.6)))
                shown = case.glass.with_bodies([*case.glass.bodies, Sphere("stray", (x, y, z), radius, glass)])
            except SceneError:
                continue
            return replace(case, glass=shown, words=("does not list", "lists every"))

    return change


def _hollow(case: Case, rng: np.random.Generator) -> Case:
    ball = case.glass.spheres[0]
    core = (Sphere(f"{ball.name} core", ball.centre_mm, 0.8 * ball.radius_mm, ConstantMedium(1.00028)),)
    hollow = _changed(case.glass, ball.name, cores=core)
    return replace(case, glass=hollow, words=("hollow", "core"))


def _not_hollow(case: Case, rng: np.random.Generator) -> Case:
    case = _hollow(case, rng)
    ball = case.given.spheres[0]
    core = (Sphere(f"{ball.name} core", ball.centre_mm, 0.8 * ball.radius_mm, ConstantMedium(1.00028)),)
    return replace(case, glass=case.bare, given=_changed(case.given, ball.name, cores=core))


def _camera_moved(case: Case, rng: np.random.Generator) -> Case:
    camera = case.glass.camera
    x, y, z = (np.array(camera.position_mm) + rng.normal(0.0, 0.04, 3)).tolist()
    moved = case.glass.with_camera(replace(camera, position_mm=(x, y, z)))
    return replace(case, glass=moved, words=("camera seem to have moved",))


def _board_moved(case: Case, rng: np.random.Generator) -> Case:
    x, y = rng.normal(0.0, 0.06, 2).tolist()
    return replace(case, pose=Pose((x, y, 0.0)), words=("board or camera seem to have moved",))


def _refocused(case: Case, rng: np.random.Generator) -> Case:
    camera = case.glass.camera
    longer = replace(
        camera, focal_px=camera.focal_px * (1.0 + float(rng.uniform(1e-3, 3e-3) * rng.choice([-1, 1])))
    )
    return replace(case, glass=case.glass.with_camera(longer), words=("focused or zoomed",))


def _lens(case: Case, **terms: float) -> Case:
    camera = replace(case.bare.camera, lens=Lens(**terms))
    shown = case.bare.with_camera(camera)
    return replace(case, bare=shown, glass=shown, words=("lens",))


def _lens_term(case: Case, rng: np.random.Generator) -> Case:
    half = (2.0 * case.bare.camera.focal_px / case.bare.camera.sensor_px[0]) ** 2
    return _lens(case, k2=float(rng.uniform(0.01, 0.03)) * half**2, p1=float(rng.uniform(2e-3, 5e-3)) * half**0.5)


def _lens_aside(case: Case, rng: np.random.Generator) -> Case:
    half = 0.5 * case.bare.camera.sensor_px[0]
    case = _lens(case, k1=float(rng.uniform(0.01, 0.03)) * (case.bare.camera.focal_px / half) ** 2)
    camera, turn = case.bare.camera, float(rng.uniform(0.0, 2.0 * np.pi))
    aside = float(rng.uniform(0.1, 0.4)) * half * np.array([np.cos(turn), np.sin(turn)])
    back = Rotation.from_rotvec([-aside[1] / camera.focal_px, aside[0] / camera.focal_px, 0.0]).as_matrix()
    a, b, c = ((float(r[0]), float(r[1]), float(r[2])) for r in back @ camera.rotation_matrix)
    middle = (camera.principal_px[0] + float(aside[0]), camera.principal_px[1] + float(aside[1]))
    shown = case.bare.with_camera(replace(camera, principal_px=middle, rotation=(a, b, c)))
    return replace(case, bare=shown, glass=shown)


def _heights(share: float) -> Callable[[Case, np.random.Generator], Case]:
    def change(case: Case, rng: np.random.Generator) -> Case:
        view = case.given.camera.position_mm[2] * case.given.camera.sensor_px[0] / case.given.camera.focal_px
        named = tuple((h * view, h * view * (1.0 + share)) for h in HEIGHTS)
        return replace(case, named_mm=named, words=("eights of the target",))

    return change


def _one_height(case: Case, rng: np.random.Generator) -> Case:
    (low, _), (high, _) = _heights(0.0)(case, rng).named_mm
    off = (low + 0.5 * float(rng.choice([-1.0, 1.0])), high)
    return replace(case, named_mm=((low, off[0]), (high, off[1])), words=(r"target[-+][\d.]+mm\.z", "height"))


def _print(share: float) -> Callable[[Case, np.random.Generator], Case]:
    def change(case: Case, rng: np.random.Generator) -> Case:
        side = case.board.square_mm * (1.0 + share)
        return replace(case, printed=Chessboard(side, 0.4 * side), words=("square_mm", "print"))

    return change


def _held_off(case: Case, rng: np.random.Generator) -> Case:
    ball = _ball(case, rng)
    x, y, z = next(s.centre_mm for s in case.glass.spheres if s.name == ball.name)
    turn, far = float(rng.uniform(0.0, 2.0 * np.pi)), float(rng.uniform(0.3, 0.8))
    placed_at = (x + far * float(np.cos(turn)), y + far * float(np.sin(turn)), z)
    given = _changed(case.given.with_bodies(case.glass.bodies), ball.name, centre_mm=placed_at)
    words = ("does not stand where it was held", "stood elsewhere", "place of", "rim of", "place")
    return replace(
        case, given=given, priors=FitTable(named={ball.name: FitNamedTable(centre_mm=0.0)}), words=words
    )


def _absent(case: Case, rng: np.random.Generator) -> Case:
    gone = _ball(case, rng)
    left = [body for body in case.glass.bodies if body.name != gone.name]
    return replace(case, glass=case.glass.with_bodies(left), words=(gone.name, "lie on the bare lattice"))


def _swapped(case: Case, rng: np.random.Generator) -> Case:
    one, other = case.given.spheres[:2]
    assert isinstance(one.medium, ConstantMedium)
    low, high = ConstantMedium(1.45), ConstantMedium(1.62)
    shown = _changed(_changed(case.glass, one.name, medium=low), other.name, medium=high)
    given = _changed(_changed(case.given, one.name, medium=high), other.name, medium=low)
    return replace(case, given=given, glass=shown, bare=shown, words=(r"glass of", r"radius, glass", r"\.n was"))


def _rod(case: Case, rng: np.random.Generator) -> Case:
    view = case.given.camera.position_mm[2] * case.given.camera.sensor_px[0] / case.given.camera.focal_px
    top = max(s.centre_mm[2] + s.radius_mm for s in case.glass.spheres) + 0.05 * view
    x = float(rng.uniform(-0.2, 0.2)) * view
    rod = Rod("wire", (x, -view, top), (x, view, top), 0.012 * view)
    return replace(case, glass=case.glass.with_bodies([*case.glass.bodies, rod]), words=("does not list",))


def _dirt(case: Case, rng: np.random.Generator) -> Case:
    u, v = (rng.uniform(0.25, 0.75, 2) * case.given.camera.sensor_px).tolist()

    def spoil(image: np.ndarray, glass: bool) -> np.ndarray:
        y, x = np.mgrid[0 : image.shape[0], 0 : image.shape[1]]
        spot = (x - u) ** 2 + (y - v) ** 2 < (0.05 * image.shape[1]) ** 2
        return np.where(spot & glass, image.min(), image).astype(image.dtype)

    return replace(case, spoil=spoil, words=("does not list",))


def _focal(case: Case, rng: np.random.Generator) -> Case:
    camera = case.given.camera
    wrong = replace(camera, focal_px=camera.focal_px * float(rng.choice([0.97, 1.03])))
    return replace(case, given=case.given.with_camera(wrong), words=("square_mm", "focal", "camera"))


def _typed(case: Case, rng: np.random.Generator) -> Case:
    camera = case.given.camera
    x, y, z = camera.position_mm
    wrong = replace(camera, position_mm=(x + 15.0 * float(rng.choice([-1.0, 1.0])), y, z))
    known = FitTable(camera=FitCameraTable(position_mm=1.0, rotation_deg=0.3))
    return replace(case, given=case.given.with_camera(wrong), priors=known, words=("camera", "board is turned"))


def _exchanged(case: Case, rng: np.random.Generator) -> Case:
    return replace(case, bare=case.glass, glass=case.bare.bare(), words=("exchanged", "glass", "bare"))


def _blurred(case: Case, rng: np.random.Generator) -> Case:
    import cv2

    def spoil(image: np.ndarray, glass: bool) -> np.ndarray:
        return np.asarray(cv2.GaussianBlur(image, (0, 0), 4.0))

    return replace(case, spoil=spoil, words=("focus", "blur"))


KINDS: dict[str, Callable[[Case, np.random.Generator], Case]] = {
    "radius 1 to 2 % too large": _radius(0.01, 0.02),
    "radius 1 to 2 % too small": _radius(-0.02, -0.01),
    "radius 5 % too large": _radius(0.04, 0.06),
    "radius 0.3 to 0.6 % too large": _radius(0.003, 0.006),
    "glass is another one": _index(0.005, 0.04, 0.1),
    "index tightly wrong": _index(2e-4, 3e-3, 2e-2),
    "index held wrong": _index(0.0, 3e-3, 2e-2),
    "balls of two glasses swapped": _swapped,
    "ball not listed": _stray(0.5, 0.9),
    "bead not listed": _stray(0.12, 0.3),
    "ball is hollow": _hollow,
    "ball is not hollow": _not_hollow,
    "ball held elsewhere": _held_off,
    "ball is not there": _absent,
    "camera moved between frames": _camera_moved,
    "board moved between frames": _board_moved,
    "lens focused between frames": _refocused,
    "lens off its axis": _lens_aside,
    "lens term missing": _lens_term,
    "heights 2 % too small": _heights(0.02),
    "heights 2 % too large": _heights(-0.02),
    "one height is wrong": _one_height,
    "print 5 % too large": _print(0.05),
    "print 5 % too small": _print(-0.05),
    "wire in the view": _rod,
    "dirt in the view": _dirt,
    "focal length 3 % wrong": _focal,
    "camera typed 15 mm aside": _typed,
    "bare and glass exchanged": _exchanged,
    "out of focus": _blurred,
}


def faulty(kind: str, seed: int) -> Case:
    """A lab with one fault of a kind; without one if the kind is empty."""
    case = right(seed)
    return KINDS[kind](case, np.random.default_rng((5601, seed))) if kind else case
