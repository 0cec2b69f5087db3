"""`rtpiv bench camera`: identify the camera, take one frame, or test its trigger."""

from pathlib import Path
from typing import Literal

import numpy as np

from daq.bench.bench_file import load_bench
from daq.bench.elements import CAMERA
from daq.bench.opened import open_bench
from daq.errors import CameraError
from daq.runner.camera_session import CameraSession
from daq.runner.trigger_check import try_trigger
from daq.runs.laser_proof import Trial
from daq.runs.raw_frame import checksum, write_raw
from ground.terminal import console
from rtpiv.verbs.paths import Named
from rtpiv.verbs.results import require_folder


def camera(
    action: Literal["list", "snap", "test"],
    /,
    bench: Named = "bench.yaml",
    simulate: bool = False,
    out: Named = "snap.tif",
) -> Path | None:
    """Say which camera the bench has, take a frame with its settings, or try its trigger out.

    Parameters
    ----------
    action : {"list", "snap", "test"}
        `test` takes a few frames with the trigger of the bench file, with the laser off, and checks that they
        arrive and have the configured exposure.
    bench : path
        bench.yaml.
    simulate : bool
        Use the simulation of the bench.
    out : path
        File of the frame, which must not exist.

    Returns
    -------
    Path or None
        File of the frame.

    Raises
    ------
    CameraError
        The camera is not there, gives no frame, or its trigger does not do what was set up.
    """
    screen = console()
    out = Path(out)
    if action == "snap":
        require_folder(out.parent)
    with open_bench(load_bench(bench), simulate, only={CAMERA}) as hardware:
        info = hardware.camera.info
        screen.print(f"{info.vendor} {info.model}, serial {info.serial}, {info.backend} at {info.address}")
        if action == "test":
            _say(try_trigger(hardware.camera, hardware.camera_section, rendering_s=hardware.rendering_s))
            return None
        exposures = CameraSession(hardware.camera, hardware.camera_section, rendering_s=hardware.rendering_s)
        settings = exposures.set_up()
        if action == "list":
            for name in sorted(settings):
                screen.print(f"  {name} = {settings[name]}")
            return None
        try:
            for _, frame in exposures.frames(1):
                with frame:
                    pixels, meta = frame.pixels.copy(), frame.meta
        finally:
            exposures.end()
    write_raw(out, pixels, {"frame_id": meta.frame_id, "crc32": checksum(pixels), "bits": meta.significant_bits})
    white = (1 << meta.significant_bits) - 1
    low, middle, high = np.percentile(pixels, (1, 50, 99))
    saturated = 100.0 * float(np.mean(pixels >= white))
    screen.print(
        f"{out}: {pixels.shape[1]} x {pixels.shape[0]} px, "
        f"1 % / median / 99 %: {low:.0f} / {middle:.0f} / {high:.0f} of {white}, saturated {saturated:.3f} %"
    )
    return out


def _say(found: list[Trial]) -> None:
    """Show what was found; CameraError if something is wrong."""
    words = {True: "ok ", False: "BAD", None: "?  "}
    for each in found:
        console().print(f"  {each.what:<10} {words[each.is_right]}  {each.said}", soft_wrap=True, highlight=False)
    if wrong := [each.what for each in found if each.is_right is False]:
        raise CameraError(f"the camera's {' and '.join(wrong)} is not as the bench file sets it up; see above")
