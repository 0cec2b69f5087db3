"""Target frames in light of many colours: the independent renderer, one picture a wavelength, in sum the spectrum.

Wavelengths 10 nm apart are enough: smooth spectra are summed exactly by the trapezoid rule, and two neighbours
differ by less than 0.1 px through N-BK7, by up to 0.9 px in the blue through plastics.
"""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from correction.fit.seen.measurement import TargetFrame
from sim.demo.scenes import at_size, demo_scene, misalign
from sim.renderer.patterns import Chessboard as Print
from sim.renderer.render import render_irradiance
from sim.renderer.sensor import Sensor
from tests.correction.fit.benches import SIZE_PX, SQUARE_MM
from tracer.media import MEDIA
from tracer.scene.scene import Scene

WAVES_NM = np.arange(420.0, 701.0, 10.0)
FINE = Sensor(white_counts=53000.0, electrons_per_count=float("inf"), read_noise_counts=0.0, bits=16)


@dataclass(frozen=True)
class Lamp:
    """A spectrum [power at WAVES_NM], and how it stands in a scene file."""

    power: np.ndarray
    told: dict

    @property
    def share(self) -> np.ndarray:
        return self.power / self.power.sum()


def _bell(mean_nm: float, sigma_nm: float) -> np.ndarray:
    return np.exp(-0.5 * ((WAVES_NM - mean_nm) / sigma_nm) ** 2)


def _flat(low_nm: float, high_nm: float) -> np.ndarray:
    ends = np.isin(WAVES_NM, (low_nm, high_nm))
    return ((low_nm <= WAVES_NM) & (high_nm >= WAVES_NM)) - 0.5 * ends


def _points(power: np.ndarray) -> dict:
    return {"points": np.column_stack((WAVES_NM, power)).tolist()}


def _lines(**power: float) -> Lamp:
    table = [[float(name[1:]), strength] for name, strength in power.items()]
    return Lamp(sum(strength * (nm == WAVES_NM) for nm, strength in table), {"lines": table})


def _white(blue: float, phosphor_nm: float, red: float) -> Lamp:
    """A white LED of another hand than `tracer.light`: pump, phosphor and a red tail."""
    power = blue * _bell(455.0, 11.0) + _bell(phosphor_nm, 48.0) + red * _bell(630.0, 30.0)
    return Lamp(power, _points(power))


LAMPS = {
    "band_450_650": Lamp(_flat(450.0, 650.0), {"band_nm": [450.0, 650.0]}),
    "band_500_600": Lamp(_flat(500.0, 600.0), {"band_nm": [500.0, 600.0]}),
    "green_led": Lamp(_bell(530.0, 15.0), {"mean_nm": 530.0, "sigma_nm": 15.0}),
    "red_led": Lamp(_bell(630.0, 10.0), {"mean_nm": 630.0, "width_nm": 10.0 * 2.35482}),
    "blue_led": Lamp(_bell(460.0, 12.0), {"mean_nm": 460.0, "sigma_nm": 12.0}),
    "white_3000": _white(0.45, 590.0, 0.5),
    "white_4000": _white(0.8, 575.0, 0.3),
    "white_5000": _white(1.3, 565.0, 0.2),
    "white_6500": _white(1.8, 558.0, 0.1),
    "line_550": _lines(w550=1.0),
    "line_590": _lines(w590=1.0),
    "mercury": _lines(w440=0.5, w550=1.0, w580=0.6),
}
TEMPERATURES = {"white_3000": 3000.0, "white_4000": 4000.0, "white_5000": 5000.0, "white_6500": 6500.0}


BK7, PLASTICS = ("N-BK7", "N-BK7"), ("PMMA", "polystyrene")


def lab_scene(glasses: tuple[str, str] = BK7) -> Scene:
    """Nominal scene with balls of two glasses."""
    nominal = at_size(demo_scene("two_spheres_500"), SIZE_PX)
    balls = zip(nominal.bodies, glasses, strict=True)
    return nominal.with_bodies([replace(ball, medium=MEDIA[glass]) for ball, glass in balls])


def true_scene(glasses: tuple[str, str] = BK7) -> Scene:
    """The same with everything a little elsewhere."""
    return misalign(lab_scene(glasses), 6)


@cache
def shown(nm: float | None, glasses: tuple[str, str]) -> np.ndarray:
    """Light that reaches the sensor at one wavelength through glass, or from the bare board."""
    truth, board = true_scene(glasses), Print(SQUARE_MM, 0.4 * SQUARE_MM)
    if nm is None:
        return render_irradiance(truth.with_bodies(()), board, samples=4, seed=1)
    return render_irradiance(replace(truth, wavelength_nm=nm), board, samples=4, seed=2)


def frames_in(share: np.ndarray | float, glasses: tuple[str, str] = BK7) -> list[TargetFrame]:
    """Frames in a spectrum, or at one wavelength."""
    if isinstance(share, float):
        light = shown(share, glasses)
    else:
        parts = zip(share, WAVES_NM.tolist(), strict=True)
        light = sum(np.float32(part) * shown(nm, glasses) for part, nm in parts if part)
    shots = (("bare", shown(None, glasses), False), ("glass", light, True))
    return [TargetFrame(name, FINE.expose(shot, seed=0), behind) for name, shot, behind in shots]
