"""Particle image velocimetry through glass: eight functions under one name.

    load_scene   read a description of camera, glass and light
    trace        ray-trace a scene: field of view and what is lost
    acquire      execute a plan, on the bench or on its simulation
    calibrate    fit the geometry of the bench to frames of the target
    correct      compute frames as if the glass were not there
    evaluate     vectors of image pairs, with errors and uncertainties
    mean         mean flow and Reynolds stresses of many pairs
    report       evaluate a run and write its report

Options that belong together are one value: `CorrectionRecipe` (`correct`, `evaluate`, `mean`), `Resampling`
(`correct`), `PairDetails` and `EvaluationOutput` (`evaluate`), `MeanOutput` (`mean`), `LiveFrames` and `Rehearsal`
(`acquire`).
Functions return values: only `acquire` and `report` print, and `trace`, `calibrate`, `evaluate` and `mean` write
only into a folder given as `out`.  Files may be given as text or as `Path`.  `docs/python.md` shows them in use.
ERRORS holds the base class of all errors that they raise on purpose, `ground.errors.RtpivError`:
``except rtpiv.ERRORS``.  Everything else is in packages of its own; each is imported when it is first used.
"""

import sys


def _end_quietly(kind, error, trace) -> None:  # type: ignore[no-untyped-def]  # noqa: ANN001 - types load later
    """Print Ctrl-C before `rtpiv.command` is loaded as that does later; other errors as Python does."""
    if not issubclass(kind, KeyboardInterrupt):
        sys.__excepthook__(kind, error, trace)
        return
    import os

    os.write(2, b"interrupted\n")
    os._exit(4)  # rtpiv.command_line.exit_codes.INTERRUPTED; nothing has begun


if sys.argv and sys.argv[0].replace("\\", "/").rpartition("/")[2] in ("rtpiv", "rtpiv.exe", "-m"):
    sys.excepthook = _end_quietly  # the command: a script that imports us keeps what it has

from importlib import import_module  # noqa: E402
from typing import Any  # noqa: E402

from rtpiv import neighbours  # noqa: E402

neighbours.install_import_hook()

_HOMES = {
    "load_scene": "tracer.scene.scene_file",
    "trace": "rtpiv.verbs.trace",
    "acquire": "rtpiv.verbs.acquire",
    "calibrate": "rtpiv.verbs.calibrate",
    "correct": "rtpiv.verbs.correct",
    "evaluate": "rtpiv.verbs.evaluate",
    "mean": "rtpiv.verbs.mean",
    "report": "rtpiv.verbs.report",
    "CorrectionRecipe": "rtpiv.analysis.recipe",
    "Resampling": "rtpiv.analysis.recipe",
    "PairDetails": "rtpiv.analysis.pairs.evaluation",
    "EvaluationOutput": "rtpiv.verbs.evaluate",
    "MeanOutput": "rtpiv.verbs.mean",
    "LiveFrames": "rtpiv.verbs.acquire",
    "Rehearsal": "daq.bench.rehearsal",
}
_VALUES = ("trace", "calibrate", "evaluate", "mean")  # print nothing, and write only where `out` says
__all__ = [*_HOMES, "ERRORS"]


def __getattr__(name: str) -> Any:  # noqa: ANN401 - whatever is asked for
    if name == "ERRORS":
        found: Any = (import_module("ground.errors").RtpivError,)
    elif name == "__version__":
        found = import_module("importlib.metadata").version("rtpiv")
    elif name in _HOMES:
        found = getattr(import_module(_HOMES[name]), name)
        if name in _VALUES:
            found = import_module("rtpiv.face").value_of(found)
        elif name == "correct":
            found = import_module("rtpiv.face").quiet(found)
        elif name == "report":
            found = import_module("rtpiv.face").in_own_style(found)
    else:
        raise AttributeError(f"rtpiv has no {name!r}; it has {', '.join(__all__)}")
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
