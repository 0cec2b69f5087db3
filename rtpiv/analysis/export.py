"""Vectors and maps written for other programs; each file whole or not there.

Tecplot and most readers of its text know no NaN: what was not measured is 0 there, and 0 in `measured`.

Maps and masks of a scene for programs that know nothing of rtpiv: NetCDF, or plain TIFF.

    NAME_correction.nc   for each node of the plane (y, x; y up, both axes rising) which pixel shows it
        pixel_u, pixel_v     acquired pixel of the best view [px]: column, row; 0, 0 is the upper left one
        status, branch       NodeStatus; which way through the glass, by number (flag_meanings names both)
        transmittance        share of the light that passes the glass
        magnification_low, _high   sensor pixels a node, the least and the most of all directions
    NAME_rays.nc         for each pixel (row, column) where its ray meets the plane
        plane_x, plane_y [mm], status (RayStatus), branch

TIFF has a file for each array, the first row on top, as images lie: NAME_u.tif and NAME_v.tif are what
`cv2.remap` and MATLAB's `interp2` take (float32: 1e-4 px), NAME_mask.tif is 255 where a node is recovered and
NAME_status.tif says why it is not, NAME_x.tif and NAME_y.tif are the rays.  Where there is nothing stands NaN.
"""

import io
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from correction.maps.correction_map import CorrectionMap, build_correction_map
from correction.node_status import MEANING
from ground.printable import utf8
from ground.whole_file import whole_file
from piv.files.frame_file import write_frame
from piv.files.vector_file import Variable, Vectors, netcdf, write_vtk
from tracer.scene.scene import Scene
from tracer.strategies.branches import Branch
from tracer.strategies.ray_map import RayMap, build_ray_map
from tracer.strategies.trace import RayStatus


def _rows(vectors: Vectors, number: int, *before: NDArray[Any]) -> NDArray[Any]:
    """Return x, y, all fields and whether there is a vector, of one time, behind some columns: a row a place."""
    y, x = np.meshgrid(vectors.y_mm, vectors.x_mm, indexing="ij")
    fields = [one[number] for one in vectors.everything.values()]
    columns = (*(np.broadcast_to(one, x.shape) for one in before), x, y, *fields, vectors.measured[number])
    return np.column_stack([column.ravel() for column in columns])


def _heads(vectors: Vectors) -> list[str]:
    """Return the heads of `_rows`."""
    places = [f"{axis} [{vectors.length_unit}]" for axis in "xy"]
    return [*places, *(vectors.called(name) for name in vectors.everything), "measured"]


def write_tecplot(path: Path, vectors: Vectors) -> list[Path]:
    """Write one text file with a zone for each time (``.dat``, POINT packing)."""
    text = io.StringIO()
    heads = ", ".join(f'"{head}"' for head in _heads(vectors))
    text.write(f'TITLE = "{_title(vectors, path)}"\nVARIABLES = {heads}\n')
    for number, time_s in enumerate(vectors.times.tolist()):
        text.write(f'ZONE T="{number}", I={len(vectors.x_mm)}, J={len(vectors.y_mm)}, DATAPACKING=POINT,')
        text.write(f" STRANDID=1, SOLUTIONTIME={time_s:.9g}\n")
        np.savetxt(text, np.nan_to_num(_rows(vectors, number)), fmt="%.9g")
    return _write_bytes(path.with_suffix(".dat"), utf8(text.getvalue()))


def write_csv(path: Path, vectors: Vectors) -> list[Path]:
    """Write one table of all times (``.csv``): a row for each place, empty cells where nothing was measured."""
    text = io.StringIO()
    for number, time in enumerate(vectors.times.tolist()):
        np.savetxt(text, _rows(vectors, number, np.array(time)), fmt="%.9g", delimiter=",")
    heads = ",".join((f"t [{vectors.time_unit or 's'}]", *_heads(vectors)))
    return _write_bytes(path.with_suffix(".csv"), utf8(f"{heads}\n{text.getvalue().replace('nan', '')}"))


def write_matlab(path: Path, vectors: Vectors) -> list[Path]:
    """Write one file of arrays (H, W, T) with names as here (``.mat``, version 5, which every MATLAB reads)."""
    arrays: dict[str, Any] = {name: np.moveaxis(one, 0, -1) for name, one in vectors.everything.items()}
    arrays |= {"x_mm": vectors.x_mm, "y_mm": vectors.y_mm, "t_s": vectors.times}
    stream = io.BytesIO()
    units = {name: unit for name, unit in vectors.units.items() if unit}
    scipy.io.savemat(
        stream, {**arrays, "units": units, "title": _title(vectors, path)}, do_compression=True, oned_as="column"
    )
    return _write_bytes(path.with_suffix(".mat"), stream.getvalue())


def _title(vectors: Vectors, path: Path) -> str:
    """Return the title of a file: its attribute, or its name."""
    title = str(vectors.attributes.get("title") or path.stem).replace('"', "")
    return utf8(" ".join(title.split())).decode()


def _write_bytes(path: Path, content: bytes) -> list[Path]:
    with whole_file(path) as stream:
        stream.write(content)
    return [path]


FORMATS: dict[str, Callable[[Path, Vectors], list[Path]]] = {
    "csv": write_csv,
    "matlab": write_matlab,
    "paraview": write_vtk,
    "tecplot": write_tecplot,
}


Variables = Mapping[str, tuple[NDArray[Any], str]]  # array and unit by name


def write_map_netcdf(scene: Scene, path: Path) -> list[Path]:
    """Trace a scene and write its correction map and its ray map (``.nc``); `path` without suffix."""
    rays, found = _maps(scene)
    least, most = found.magnification()
    nodes = found.grid
    height, width = nodes.shape
    of_nodes: dict[str, tuple[NDArray[Any], str]] = {
        "pixel_u": (found.pixel[0, ..., 0], "px"),
        "pixel_v": (found.pixel[0, ..., 1], "px"),
        "status": (found.status, "1"),
        "branch": (found.branch[0], "1"),
        "transmittance": (found.transmittance[0], "1"),
        "magnification_low": (least, "1"),
        "magnification_high": (most, "1"),
    }
    x_mm = nodes.to_mm(np.column_stack((np.arange(width), np.zeros(width))))[:, 0]
    y_mm = nodes.to_mm(np.column_stack((np.zeros(height), np.arange(height))))[::-1, 1]
    written = path.with_name(f"{path.name}_correction.nc")
    upwards = {name: (values[::-1], unit) for name, (values, unit) in of_nodes.items()}
    meanings = [f"{status.value} {MEANING[status]}" for status in MEANING]
    _netcdf(written, {"y": (y_mm, "mm"), "x": (x_mm, "mm")}, upwards, meanings, scene, found.branches)
    of_rays = {
        "plane_x": (rays.plane_mm[..., 0], "mm"),
        "plane_y": (rays.plane_mm[..., 1], "mm"),
        "status": (rays.status, "1"),
        "branch": (rays.branch, "1"),
    }
    rows, columns = (np.arange(count, dtype=np.float64) for count in rays.status.shape)
    beside = path.with_name(f"{path.name}_rays.nc")
    meanings = [f"{status.value} {status.name.lower()}" for status in RayStatus]
    _netcdf(beside, {"row": (rows, "px"), "column": (columns, "px")}, of_rays, meanings, scene, rays.branches)
    return [written, beside]


def write_map_tiff(scene: Scene, path: Path) -> list[Path]:
    """Trace a scene and write its maps and its mask as images (``.tif``); `path` without suffix."""
    rays, found = _maps(scene)
    images: dict[str, NDArray[Any]] = {
        "u": found.pixel[0, ..., 0].astype(np.float32),
        "v": found.pixel[0, ..., 1].astype(np.float32),
        "mask": np.where(found.recovered, 255, 0).astype(np.uint8),
        "status": found.status,
        "x": rays.plane_mm[..., 0].astype(np.float32),
        "y": rays.plane_mm[..., 1].astype(np.float32),
    }
    about = {"scene": scene.content_hash(), "origin_mm": list(found.grid.origin_mm)}
    written = []
    for name, image in images.items():
        written.append(path.with_name(f"{path.name}_{name}.tif"))
        write_frame(written[-1], image, found.grid.px_per_mm, {"holds": name, **about})
    return written


def _maps(scene: Scene) -> tuple[RayMap, CorrectionMap]:
    rays = build_ray_map(scene)
    return rays, build_correction_map(scene, rays)


def _netcdf(
    path: Path,
    axes: Variables,
    variables: Variables,
    meanings: Sequence[str],
    scene: Scene,
    branches: Sequence[Branch],
) -> None:
    ways = "; ".join(f"{number} {' > '.join(way) or 'direct'}" for number, way in enumerate(branches))
    said = {"status": {"flag_meanings": ", ".join(meanings)}, "branch": {"flag_meanings": ways}}
    found = {name: Variable((name,), values, unit) for name, (values, unit) in axes.items()}
    for name, (values, unit) in variables.items():
        found[name] = Variable(tuple(axes), values, unit, said.get(name, {}))
    with whole_file(path) as whole:
        whole.write(netcdf(found, {"scene_hash": scene.content_hash()}))


MAP_FORMATS: dict[str, Callable[[Scene, Path], list[Path]]] = {
    "netcdf": write_map_netcdf,
    "tiff": write_map_tiff,
}
