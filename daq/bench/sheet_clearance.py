"""How far glass and target are from the light sheet, which lies in the investigation plane z = 0."""

from collections.abc import Mapping

from daq.bench.bench_table import CAMERA, GLASS, TARGET, Bench


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
        Below 0 if the sheet is cut; infinity if there is neither glass nor target.  A tube around the sheet does
        not count: the light goes in through it.
    """
    distances = [float("inf")]
    table = bench.table
    z_mm = {one: table.offset_mm(one, positions_mm)[2] for one in (GLASS, CAMERA)}
    for body in bench.scene.bodies:
        off_mm = z_mm.get(body.carried, 0.0)
        gap_mm = max(body.lowest_mm + off_mm, -body.highest_mm - off_mm)
        if gap_mm > 0.0 or not body.may_cross_plane:
            distances.append(gap_mm)
    if bench.table.axes_of(TARGET):
        front_mm = bench.table.offset_mm(TARGET, positions_mm)[2]
        keep_out = bench.table.keep_out
        thick_mm = 0.0 if keep_out is None else keep_out.target_size_mm[2]
        distances.append(-front_mm if front_mm <= 0.0 else front_mm - thick_mm)
    return min(distances)
