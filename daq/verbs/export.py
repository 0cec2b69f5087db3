"""`rtpiv export`: vectors for MATLAB, ParaView and Tecplot; PIVPy and xarray read the NetCDF files as they are."""

from collections.abc import Sequence
from pathlib import Path

from daq.analysis.export.formats import FORMATS
from daq.analysis.export.vector_table import read_vectors
from daq.errors import DiskError, RunUsageError
from daq.terminal import console, progress_if_long
from daq.verbs.output import require_folder
from daq.verbs.paths import Named
from daq.whole_text import sync_folder, why


def export(files: Sequence[Named], to: str, out: Named = "exported") -> list[Path]:
    """Write vectors in another program's format.

    Parameters
    ----------
    files : sequence of path
        NetCDF files of `evaluate` and `mean`: ``vectors.nc``, ``mean.nc``, chunks of a series.
    to : {"matlab", "paraview", "tecplot"}
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
        A file holds no vectors on a grid, or two would get one name.
    DiskError
        The folder cannot hold them.
    """
    sources = [Path(file) for file in files]
    if to not in FORMATS:
        raise RunUsageError(f"{to!r}: there are {', '.join(FORMATS)}")
    if len({source.stem for source in sources}) < len(sources):
        raise RunUsageError("two of the files have one name and would get one file; export them one by one")
    out = require_folder(out)
    out.mkdir(parents=True, exist_ok=True)
    written: list[Path] = []
    for source in progress_if_long(sources, len(sources), "files"):
        table = read_vectors(source)
        try:
            written += FORMATS[to](table, out / source.stem)
        except OSError as error:
            raise DiskError(f"{out}: {why(error)}; make room, then try again") from error
    sync_folder(out)
    console().print(f"{len(written)} file{'s' if len(written) > 1 else ''} for {to} in {out}", soft_wrap=True)
    return written
