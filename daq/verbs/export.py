"""`rtpiv export`: vectors for MATLAB, ParaView and Tecplot, maps of a scene as NetCDF or TIFF.

PIVPy and xarray read the NetCDF files of vectors as they are.
"""

from collections.abc import Sequence
from pathlib import Path

from daq.analysis.export.formats import FORMATS
from daq.analysis.export.map_files import MAP_FORMATS
from daq.analysis.export.vector_table import read_vectors
from daq.errors import DiskError, RunUsageError
from daq.terminal import console, progress_if_long
from daq.verbs.output import require_folder
from daq.verbs.paths import Named
from daq.whole_text import sync_folder, why
from tracer.scene_file import load_scene

SCENES = (".yaml", ".yml")


def export(files: Sequence[Named], to: str, out: Named = "exported") -> list[Path]:
    """Write vectors, or the maps of a scene, in another program's format.

    Parameters
    ----------
    files : sequence of path
        NetCDF files of `evaluate` and `mean`: ``vectors.nc``, ``mean.nc``, chunks of a series.  For maps
        scene files, as known or as fitted: what particles in their light sheet are corrected by.
    to : {"matlab", "paraview", "tecplot"}, or {"netcdf", "tiff"} of scene files
        For whom.
    out : path
        Folder; files keep their names.

    Returns
    -------
    list of Path
        What was written.

    Raises
    ------
    RunUsageError
        A file holds no vectors on a grid, two would get one name, or the format is not one of its kind.
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
        if (source.suffix in SCENES) != (to in MAP_FORMATS):
            kind, formats = ("a scene", MAP_FORMATS) if source.suffix in SCENES else ("vectors", FORMATS)
            raise RunUsageError(f"{source}: {kind} can be exported to {' or '.join(formats)}, not {to}")
    if len({source.stem for source in sources}) < len(sources):
        raise RunUsageError("two of the files have one name and would get one file; export them one by one")
    out = require_folder(out)
    out.mkdir(parents=True, exist_ok=True)
    written: list[Path] = []
    for source in progress_if_long(sources, len(sources), "files"):
        try:
            if to in MAP_FORMATS:
                written += MAP_FORMATS[to](load_scene(source).in_light_sheet(), out / source.stem)
            else:
                written += FORMATS[to](read_vectors(source), out / source.stem)
        except OSError as error:
            raise DiskError(f"{out}: {why(error)}; make room, then try again") from error
    sync_folder(out)
    console().print(f"{len(written)} file{'s' if len(written) > 1 else ''} for {to} in {out}", soft_wrap=True)
    return written
