"""Drawn light sheets, one row each: how far off they are found, and whether their sigma covers that.

    python -m tests.correction.light_sheet.sheet_table --sheets 30 --workers 16 -o sheets.csv

Sheets are off by up to 0.6 mm and half a degree, behind one, two and three balls and a pyramid in turn.  The flow
is a turbulent jet, of which the program knows nothing; the sensor shows what is near the balls.
"""

import argparse
import csv
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass, fields
from multiprocessing import get_context
from pathlib import Path
from unittest import mock

import numpy as np
from numpy.typing import NDArray

from correction.light_sheet import disparities, self_calibration
from correction.light_sheet.double_views import double_views
from correction.light_sheet.forecast import sheet_forecast
from correction.light_sheet.self_calibration import find_sheet
from sim.flow.modes import RandomModes
from tests.correction.light_sheet.particle_frames import camera, frames_of

LABS = (  # scene, width of the sensor and of what is drawn of it [px], pairs
    ("one_sphere_500", 504, None, 40),
    ("two_spheres_500", 1008, 560, 30),
    ("three_spheres_500", 504, None, 20),
    ("pyramid_500", 1008, None, 40),
)


@dataclass(frozen=True)
class Row:
    """One sheet: truth, what was found beside it, sigmas, and the range of the sigma that was foreseen."""

    number: int
    scene: str
    z_mm: float
    off_mm: float
    off_x_deg: float
    off_y_deg: float
    sigma_mm: float
    sigma_deg: float
    least_mm: float
    most_mm: float
    is_found: bool
    seconds: float
    words: str

    @property
    def in_sigmas(self) -> NDArray[np.float64]:
        """Height and tilts (3,) beside the truth."""
        off = np.array([self.off_mm, self.off_x_deg, self.off_y_deg])
        return np.asarray(off / [self.sigma_mm, self.sigma_deg, self.sigma_deg])


def drawn_sheets(count: int) -> Iterator[tuple[float, float, float]]:
    """Height [mm] and tilts [degree] of so many sheets."""
    rng = np.random.default_rng(33)
    for _ in range(count):
        z_mm, *tilts_deg = np.round(rng.uniform(-1.0, 1.0, 3) * (0.6, 0.5, 0.5), 3).tolist()
        yield z_mm, tilts_deg[0], tilts_deg[1]


def found(number: int, z_mm: float, *tilts_deg: float) -> Row:
    """Photograph the flow in a sheet and look for it."""
    began = time.process_time()
    name, size_px, crop_px, pairs = LABS[number % len(LABS)]
    more = {"seed": 100 + number, "modes": RandomModes(8.0, seed=number), "crop_px": crop_px}
    flow_camera = camera(name, size_px, z_mm, tilts_deg, **more)
    with (
        mock.patch.object(self_calibration, "MOST_PLACES", 6000),
        mock.patch.object(disparities, "MODELLED", 600),
        mock.patch.object(disparities, "LEAST_MODELLED", 12),
    ):
        foreseen = sheet_forecast(flow_camera.scene, double_views(flow_camera.scene, step=3), pairs=pairs)
        result = find_sheet(flow_camera.scene, frames_of(flow_camera, pairs))
    sheet = result.sheet
    return Row(
        number,
        name,
        z_mm,
        sheet.z_mm - z_mm,
        sheet.tilt_x_deg - tilts_deg[0],
        sheet.tilt_y_deg - tilts_deg[1],
        sheet.sigma_mm,
        sheet.tilt_sigma_deg,
        *foreseen.range_mm,
        result.cells is not None and sheet != result.known,
        time.process_time() - began,
        " | ".join(map(str, result.verdicts)),
    )


def found_sheets(count: int, workers: int, out: Path | None = None) -> list[Row]:
    """So many sheets, written as they are found."""
    rows: list[Row] = []
    with ProcessPoolExecutor(workers, get_context("spawn"), max_tasks_per_child=1) as pool:
        waiting = [pool.submit(found, number, *sheet) for number, sheet in enumerate(drawn_sheets(count))]
        for done in as_completed(waiting):
            rows.append(done.result())
            if out is not None:
                with out.open("w", newline="") as file:
                    table = csv.DictWriter(file, [one.name for one in fields(Row)])
                    table.writeheader()
                    table.writerows(map(asdict, rows))
    return rows


def summed(rows: Sequence[Row]) -> str:
    """One line a scene, and one of all."""
    lines = []
    for scene in (*dict.fromkeys(row.scene for row in rows), "all"):
        own = [row for row in rows if scene in (row.scene, "all")]
        told = [row for row in own if row.is_found]
        off = np.array([row.in_sigmas for row in told]).reshape(-1, 3)
        height, every = (
            f"{np.mean(np.abs(part) < 1.0):.2f} (chi {np.sqrt(np.mean(part**2)):.2f}, mean {np.mean(part):+.2f})"
            if part.size
            else "none"
            for part in (off[:, 0], off)
        )
        near = sum(abs(row.off_mm) <= 0.03 for row in told)
        lines.append(
            f"{scene:17s} {len(own):3d} sheets, {len(told)} found, {near} within 0.03 mm;"
            f" one sigma covers the height in {height}, height and tilts in {every}"
        )
    return "\n".join(lines)


def main() -> None:
    """Find so many sheets."""
    ask = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ask.add_argument("--sheets", type=int, default=30)
    ask.add_argument("--workers", type=int, default=1)
    ask.add_argument("-o", "--out", type=Path, default=Path("sheets.csv"))
    given = ask.parse_args()
    print(summed(found_sheets(given.sheets, given.workers, given.out)))


if __name__ == "__main__":
    main()
