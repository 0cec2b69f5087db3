"""Camera backends: one file each, one line here.

A bench file names a backend (`harvesters`, `aravis`, `micromanager`, `files`) or, for a camera outside this
project, a dotted "package.module:Class".  A backend is imported only when it is asked for, so there is no need of
libraries for cameras that stand elsewhere.
"""

from collections.abc import Callable
from importlib.util import find_spec
from typing import Any, cast

from daq.cameras.camera import Camera
from daq.errors import CameraSetupError
from ground.named_program import UnknownName, program_of

BACKENDS = {
    "harvesters": "daq.cameras.harvesters:HarvestersCamera",
    "aravis": "daq.cameras.aravis:AravisCamera",
    "micromanager": "daq.cameras.micromanager:MicroManagerCamera",
    "files": "daq.cameras.files:FilesCamera",
}
LIBRARIES = {"harvesters": ("harvesters", "genicam")}  # of the extra rtpiv[camera]


def require_libraries(backend: str) -> None:
    """Look whether a backend's libraries are installed, before anything is waited for.

    Raises
    ------
    CameraSetupError
        Some are not; the message names them and the extra that brings them.
    """
    missing = [name for name in LIBRARIES.get(backend, ()) if find_spec(name) is None]
    if missing:
        raise CameraSetupError(
            f"camera backend {backend!r} needs {' and '.join(missing)}; install the extra rtpiv[camera]"
        )


def backend_class(backend: str) -> Callable[..., Camera]:
    """Return the constructor of the named backend.

    Raises
    ------
    CameraSetupError
        The backend is unknown, or cannot be imported.
    UntrustedProgram
        It is of another project, and not trusted.
    """
    try:
        return cast("Callable[..., Camera]", program_of(backend, BACKENDS))
    except UnknownName:
        from ground.plain_words import near  # and pydantic, for which no camera's process need wait

        known = f"use one of {', '.join(BACKENDS)}{near(backend, list(BACKENDS))}"
        raise CameraSetupError(f"camera backend {backend!r} is unknown; {known}") from None
    except (ImportError, AttributeError) as error:
        raise CameraSetupError(f"camera backend {backend!r} cannot be loaded: {error}") from error


def make_camera(backend: str, **options: Any) -> Camera:  # noqa: ANN401 - each backend checks its own options
    """Return a closed camera of the named backend.

    Raises
    ------
    CameraSetupError
        If the backend is unknown or does not take these options.
    """
    try:
        return backend_class(backend)(**options)
    except TypeError as error:
        raise CameraSetupError(f"camera backend {backend!r}: {error}") from error
