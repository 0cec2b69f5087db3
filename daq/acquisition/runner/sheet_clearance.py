"""How far glass and target are from the light sheet, which lies in the investigation plane z = 0."""

from collections.abc import Mapping

from daq.acquisition.bench.bench_table import GLASS, TARGET, Bench


def sheet_clearance_mm(bench: Bench, positions_mm: Mapping[str, float]) -> float:
    """Return the distance [mm] from the sheet to the nearest body or the target.

    Parameters
    ----------
    bench : Bench
        What stands there, and which axes carry it.
    positions_mm : mapping
        Measured position of every axis.

    Returns
    -------
    float
        Below 0 if the sheet is cut; infinity if there is neither glass nor target.
    """
    distances = [float("inf")]
    glass_z_mm = bench.table.offset_mm(GLASS, positions_mm)[2]
    for body in bench.scene.bodies:
        ends_mm = [end[2] + glass_z_mm for end in (body.capsule.start_mm, body.capsule.end_mm)]
        nearest_mm = 0.0 if min(ends_mm) <= 0.0 <= max(ends_mm) else min(abs(end) for end in ends_mm)
        distances.append(nearest_mm - body.capsule.radius_mm)
    if bench.table.axes_of(TARGET):
        front_mm = bench.table.offset_mm(TARGET, positions_mm)[2]
        keep_out = bench.table.keep_out
        thick_mm = 0.0 if keep_out is None else keep_out.target_size_mm[2]
        distances.append(-front_mm if front_mm <= 0.0 else front_mm - thick_mm)
    return min(distances)
