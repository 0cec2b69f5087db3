"""`rtpiv report --view`: look at vectors in the browser, and post-process them."""

from pathlib import Path

from daq.errors import RunUsageError
from ground.terminal import console
from piv.files.vector_file import read_vectors
from rtpiv.options.numbers import Port
from rtpiv.verbs.local_page import require_live, serve_page
from rtpiv.verbs.paths import Named

SHOWN = ("vectors.nc", "mean.nc")  # of a folder, the first that is there


def view(results: Named, /, scene: Named | None = None, port: Port = 0) -> Path | None:
    """Look at vectors over their frame in the browser, until Ctrl-C.

    The page shows values and uncertainties under the mouse, profiles along a line, and the scatter plot of u
    and v; evaluates one place with windows of other sizes; and writes the vectors that pass chosen criteria to a
    new file, after showing which ones fail.

    Parameters
    ----------
    results : path
        Folder of `evaluate` or `mean`, or a file of vectors in it, such as ``vectors.nc``.
    scene : path, optional
        Scene that the pair was evaluated with, for its frames; default the scene.yaml beside the file.
    port : int
        Port of the page on this computer; 0 for any free one.

    Returns
    -------
    Path or None
        The file that was written, if one was.

    Raises
    ------
    RunUsageError
        The extra is not installed, the folder holds no vectors, or the port is taken.
    VectorFileError
        The file is damaged or holds no vectors on a grid.
    """
    require_live()
    from rtpiv.analysis.browser.pair_frames import frames_of_pair
    from rtpiv.analysis.browser.vector_page import VectorPage, output_of  # needs the extra

    path = _vector_file(Path(results))
    vectors, screen = read_vectors(path), console()
    frames = frames_of_pair(path, vectors.attributes.get("scene_hash"), None if scene is None else Path(scene))
    if isinstance(frames, str):
        screen.print(frames, soft_wrap=True, highlight=False)
    output = output_of(path)
    before = _modification_time(output)
    serve_page(lambda: VectorPage(path, vectors, frames, port))
    if _modification_time(output) == before:
        return None
    screen.print(f"written: {output}", soft_wrap=True)
    return output


def _vector_file(path: Path) -> Path:
    """Return the file of vectors of a folder, or the file that is named."""
    if not path.is_dir():
        return path
    found = next((path / name for name in SHOWN if (path / name).is_file()), None)
    if found is not None:
        return found
    inside = sorted(path.glob("*/vectors.nc")) + sorted(path.glob("**/chunks/*.nc"))
    if inside:
        raise RunUsageError(f"{path}: holds several results; name one of them, such as {inside[0]}")
    raise RunUsageError(f"{path}: holds no vectors.nc or mean.nc; name a folder of rtpiv evaluate or rtpiv mean")


def _modification_time(path: Path) -> int | None:
    return path.stat().st_mtime_ns if path.is_file() else None
