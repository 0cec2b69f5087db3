"""`rtpiv setup mask`: draw a mask on a frame in the browser."""

from pathlib import Path

from daq.errors import RunUsageError
from daq.runs.acquired import read_acquired
from ground.terminal import console
from rtpiv.options.numbers import Port
from rtpiv.verbs.local_page import require_live, serve_page
from rtpiv.verbs.paths import Named
from tracer.masked import left_out


def mask(frame: Named, /, out: Named = "mask.png", port: Port = 0) -> Path:
    """Draw on a frame what is to be left out, in the browser, until Ctrl-C.

    Parameters
    ----------
    frame : path
        Any frame of the camera, also one of a run, a stack or a video.
    out : path
        PNG of the size of the frame, white in excluded regions; an existing one is edited.  Name it in the scene
        under `masked`, or use it in one evaluation by `--mask`.
    port : int
        Port of the page on this computer; 0 for any free one.

    Returns
    -------
    Path
        The picture.

    Raises
    ------
    FrameError, FrameDamaged, RunDamaged
        The frame cannot be read.
    SceneError
        The picture that is there is of another size, or none.
    RunUsageError
        The extra is not installed, the picture is to be no PNG, or the port is taken.
    """
    require_live()
    from daq.live.mask_page import MaskPage  # needs the extra

    path, out = Path(frame), Path(out)
    if out.suffix.lower() != ".png":
        raise RunUsageError(f"{out}: a mask is written as PNG; name it {out.stem}.png")
    pixels = read_acquired(path)
    height, width = pixels.shape
    begun = left_out(out, (width, height)) if out.exists() else ()
    serve_page(lambda: MaskPage(path.name, pixels, out, begun, port))
    if out.exists():
        screen = console()
        screen.print(f"in the scene file:  masked: [{{why: left out, picture: {out.name}}}]", soft_wrap=True)
        screen.print(f"or for one evaluation:  --mask {out}", soft_wrap=True)
    return out
