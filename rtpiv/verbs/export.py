"""`rtpiv export`: export vectors (CSV, MATLAB, ParaView, Tecplot) and maps (NetCDF, TIFF).

PIVPy and xarray read the NetCDF files of vectors as they are.
"""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from daq.atomic_write import disk_errors, sync_folder
from daq.errors import RunUsageError
from ground.plain_words import quantity
from ground.terminal import console, progress_if_long
from piv.files.vector_file import Vectors, read_vectors
from rtpiv.analysis.export import FORMATS, MAP_FORMATS
from rtpiv.verbs.paths import Named
from rtpiv.verbs.results import results_in
from tracer.scene.scene_file import load_scene

SCENES = (".yaml", ".yml")
ENDINGS = {  # of the files of each format
    "csv": (".csv",),
    "matlab": (".mat",),
    "tecplot": (".dat",),
    "paraview": (".vtk", "_00000.vtk"),
    "netcdf": ("_correction.nc", "_rays.nc"),
    "tiff": ("_mask.tif", "_status.tif", "_u.tif", "_v.tif", "_x.tif", "_y.tif"),
}
MOST_NAMED = 8  # variables of a file
MAPS_SAID = (
    "pixels [px] of nodes, and places on the plane [mm] of pixels; NaN where nothing is recovered or met, and"
    " status says why"
)


def export(
    files: Sequence[Named],
    /,
    to: Literal["csv", "matlab", "paraview", "tecplot", "netcdf", "tiff"],
    out: Named | None = None,
    overwrite: bool = False,
) -> list[Path]:
    """Write vectors, or the maps of a scene, in another program's format.

    Parameters
    ----------
    files : sequence of path
        NetCDF files of `evaluate` and `mean`: ``vectors.nc``, ``mean.nc``, chunks of a series.  For maps
        scene files, nominal or fitted: the correction of particles in their light sheet.
    to : {"csv", "matlab", "paraview", "tecplot"}, or {"netcdf", "tiff"} of scene files
        Format; ``csv`` is a table for spreadsheets and scripts.
    out : path, optional
        Folder, default ``exported`` (or ``exported-2`` ... where that has results); files keep their names, and
        are prefixed by their folders where several are equal.
    overwrite : bool
        Overwrite files in the given folder that were made from other input.

    Returns
    -------
    list of Path
        What was written.

    Raises
    ------
    RunUsageError
        A file is not there, or a folder, or named twice; or the format is not one of its kind.
    VectorFileError
        A file is damaged or holds no vectors on a grid.
    ConfigError
        A scene file is wrong.
    DiskError
        The folder cannot hold them.
    """
    sources = [Path(file) for file in files]
    if to not in FORMATS | MAP_FORMATS:
        raise RunUsageError(
            f"{to!r}: there are {', '.join(FORMATS)} of vectors, {', '.join(MAP_FORMATS)} of scenes"
        )
    for source in sources:
        _require_file(source)
        if (source.suffix in SCENES) != (to in MAP_FORMATS):
            kind, formats = ("a scene", MAP_FORMATS) if source.suffix in SCENES else ("vectors", FORMATS)
            if to == "netcdf":
                raise RunUsageError(f"{source}: is NetCDF already, which PIVPy and xarray read as it is")
            raise RunUsageError(f"{source}: {kind} can be exported to {' or '.join(formats)}, not {to}")
    names = _names(sources)
    made_from = {
        f"{name}{ending}": source for source, name in zip(sources, names, strict=True) for ending in ENDINGS[to]
    }
    with results_in(out, "exported", overwrite=overwrite, made_from=made_from) as out:
        written: list[Path] = []
        said = MAPS_SAID
        for source, name in progress_if_long(list(zip(sources, names, strict=True)), len(sources), "files"):
            with disk_errors(out):
                if to in MAP_FORMATS:
                    written += MAP_FORMATS[to](load_scene(source).in_light_sheet(), out / name)
                else:
                    vectors = read_vectors(source)
                    written += FORMATS[to](out / f"{name}{ENDINGS[to][0]}", vectors)
                    said = _describe(vectors, to)
        sync_folder(out)
        console().print(
            f"{quantity(len(written), 'file')} for {to} in {out}: {said}", soft_wrap=True, highlight=False
        )
        return written


def _names(sources: Sequence[Path]) -> list[str]:
    """Names of the results: those of the files, and of as many folders above them as tell all apart."""
    places = [Path(os.path.realpath(source)).with_suffix("").parts[1:] for source in sources]
    for depth in range(1, max(map(len, places), default=0) + 1):
        names = ["_".join(place[-depth:]) for place in places]
        if len(set(names)) == len(names):
            return names
    raise RunUsageError("a file is named twice; name each once")


def _require_file(source: Path) -> None:
    """Refuse what is not there and what is no file, by its name."""
    if source.is_dir():
        inside = sorted(path.name for path in source.iterdir() if path.suffix in (".nc", *SCENES))
        cure = f"; name files in it, such as {inside[0]}" if inside else " without files that can be exported"
        raise RunUsageError(f"{source}: is a folder{cure}")
    if not source.exists():
        raise RunUsageError(f"{source}: is not there; name a vectors.nc, mean.nc, chunk of a series or scene.yaml")


def _describe(vectors: Vectors, to: str) -> str:
    """Return the variables of the files with units, and the value where nothing was measured."""
    names = [vectors.called(name) for name in vectors.everything]
    more = f" and {len(names) - MOST_NAMED} more" if len(names) > MOST_NAMED else ""
    gaps = {"tecplot": "0 in them and in measured", "csv": "nothing"}.get(to, "NaN")
    return (
        f"{', '.join(names[:MOST_NAMED])}{more}, over x, y [{vectors.length_unit}]"
        f" and t [{vectors.time_unit or 's'}];"
        f" where nothing was measured stands {gaps}"
    )
