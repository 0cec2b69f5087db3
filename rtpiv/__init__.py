"""Particle image velocimetry through glass: the eight things people need, under one name.

    load_scene   what you know of your bench: camera, glass, light
    trace        what of the plane that scene shows
    acquire      carry a plan out, on the bench or on its simulation
    calibrate    where everything really is, from frames of the target
    correct      frames as if the glass were not there
    evaluate     vectors of pairs, with errors and uncertainty
    mean         mean flow and Reynolds stresses of many pairs
    report       a run as one page

What belongs together is one value: `CorrectionRecipe` (`correct`, `evaluate`, `mean`), `Resampling` (`correct`),
`PairDetails` and `EvaluationOutput` (`evaluate`), `MeanOutput` (`mean`), `LiveFrames` and `Rehearsal` (`acquire`).
Values come in and values go out: nothing is printed but by `acquire` and `report`, and `trace`, `calibrate`,
`evaluate` and `mean` write only into a folder that is named (`out`).  Files may be named as text or as `Path`.
`docs/python.md` goes through them.  ERRORS holds the root of all that they raise on purpose,
`ground.errors.RtpivError`: ``except rtpiv.ERRORS``.  What else there is lies in packages of their own; each is
imported when it is first used.
"""

import sys


def _end_quietly(kind, error, trace) -> None:  # type: ignore[no-untyped-def]  # noqa: ANN001 - types load later
    """Say of Ctrl-C before `rtpiv.command` is loaded what it says after that; of all else what Python says."""
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

neighbours.make_room()

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
