"""What a lab could build: every combination of the lenses, distances and balls that it has."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

from daq.errors import RunUsageError
from rtpiv.options.numbers import Count, Length, Positive
from rtpiv.templates.arrangement import most_balls
from rtpiv.templates.lab import Lab

MOST = 5000  # combinations: half a minute


@dataclass(frozen=True)
class ViewQuestion:
    """One camera, and what there is to choose from; lengths in mm.

    Parameters
    ----------
    lenses_mm : sequence of float
        Focal lengths.
    distances_mm : sequence of float
        From the lens to the plane.
    balls_mm : sequence of float
        Diameters of balls.
    counts : sequence of int
        Numbers of balls.
    arrangements : sequence of str
        How they stand: behind, beside, triangle, pyramid ...
    glasses : sequence of str
        Of what: acrylic, borosilicate, BK7 ..., or an index.
    gaps_mm : sequence of float
        From the plane to the lowest ball.
    sensor_px : (int, int)
        Width and height of the camera's frames.
    pixel_pitch_um : float
        Size of a pixel.
    wavelength_nm : float
        Of the light.

    Raises
    ------
    RunUsageError
        More than `MOST` combinations.
    """

    lenses_mm: Sequence[Positive]
    distances_mm: Sequence[Positive]
    balls_mm: Sequence[Positive]
    counts: Sequence[Count] = (1, 2, 3)
    arrangements: Sequence[str] = ("behind",)
    glasses: Sequence[str] = ("BK7",)
    gaps_mm: Sequence[Length] = (0.0,)
    sensor_px: tuple[Count, Count] = (2016, 2016)
    pixel_pitch_um: Positive = 11.0
    wavelength_nm: Positive = 532.0

    def __post_init__(self) -> None:
        if self.combinations > MOST:
            raise RunUsageError(f"{self.combinations} combinations are more than {MOST}; ask for fewer at a time")

    @property
    def combinations(self) -> int:
        """How many there are, those that cannot be among them."""
        lengths = len(self.lenses_mm) * len(self.distances_mm) * len(self.balls_mm) * len(self.gaps_mm)
        return lengths * len(self.counts) * len(self.arrangements) * len(self.glasses)

    def labs(self) -> tuple[list[Lab], list[str]]:
        """Return what can be built, and of the rest why not; an arrangement that has no such number is no rest."""
        found, refused = [], []
        choices = (self.arrangements, self.counts, self.glasses, self.balls_mm, self.gaps_mm)
        for shape, count, glass, ball_mm, gap_mm in product(*choices):
            for distance_mm, lens_mm in product(self.distances_mm, self.lenses_mm):
                try:
                    lab = Lab(
                        sensor_px=(self.sensor_px[0], self.sensor_px[1]),
                        pixel_pitch_um=self.pixel_pitch_um,
                        lens_mm=lens_mm,
                        distance_mm=distance_mm,
                        arrangement=shape,
                        balls=count,
                        ball_mm=ball_mm,
                        gap_mm=gap_mm,
                        glass=glass,
                        wavelength_nm=self.wavelength_nm,
                    )
                except RunUsageError as error:
                    if count in most_balls(shape):
                        refused.append(str(error))
                    continue
                found.append(lab)
        return found, list(dict.fromkeys(refused))
