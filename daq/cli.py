"""The command line: a verb is called, and what came of it is said in one sentence and an exit code.

Every verb is a public function of the same name in ``daq.verbs``; it is imported only when its verb is
called, so that ``rtpiv --help`` answers at once.  What people can get wrong comes back as one sentence.

Exit codes: 0 done, 2 usage or configuration, 3 device or disk, 4 interrupted and resumable.
"""

import errno
import importlib
import os
import sys
from collections.abc import Sequence
from typing import Any

import ground.compile_news as compile_news
from daq.options import parser

DONE, USAGE, DEVICE, INTERRUPTED = 0, 2, 3, 4
THREADS = ("RTPIV_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "OPENCV_FOR_THREADS_NUM")  # who has some


def _options(arguments: Sequence[str] | None) -> dict[str, Any]:
    """Read the words of a command; axes may stand behind options too, where argparse looks for them no more."""
    known, left = parser().parse_known_args(arguments)
    options = vars(known)
    if left and options["verb"] == "stage" and not any(word.startswith("-") for word in left):
        options["axes"] += left
    elif left:
        parser().error(f"unrecognized arguments: {' '.join(left)}")
    return options


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one verb; return the exit code."""
    options = _options(arguments)
    verb, threads = options.pop("verb"), options.pop("threads")
    if threads is not None:
        os.environ.update(dict.fromkeys(THREADS, str(threads)))  # for children as well; no library is loaded yet
    compile_news.watch = print_compiling
    function = getattr(importlib.import_module(f"daq.verbs.{verb}"), verb)
    try:
        function(**options)
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return INTERRUPTED
    except Exception as error:
        code = _exit_code(error)
        if code is None:
            raise
        print(f"rtpiv {verb}: {_sentence(error)}", file=sys.stderr)
        return code
    return DONE


def print_compiling(functions: int, seconds: float) -> None:
    """Say on standard error why nothing else happens: kernels are compiled once on each computer."""
    if functions == 0:
        text = "compiling, first use on this computer, about a minute in all"
    else:
        text = f"compiling: {functions} functions, {seconds:.0f} s"
    print(text, file=sys.stderr, flush=True)


def _sentence(error: Exception) -> str:
    """What to tell the person; an error of the system itself knows only a file and a reason."""
    if isinstance(error, OSError) and error.filename is not None and error.strerror:
        cure = "make room on the disk" if error.errno == errno.ENOSPC else "give another path, or mend this one"
        return f"{error.filename}: {error.strerror.lower()}; {cure}"
    return str(error)


def _exit_code(error: Exception) -> int | None:
    """Exit code of an error that a person can cure; None for a bug."""
    from correction.errors import CorrectionError, FrameDamaged
    from daq.errors import CameraUsageError, DaqError, RunInterrupted, RunUsageError
    from ground.errors import GroundError
    from stages.errors import StageError, StageUsageError
    from tracer.errors import TracerError

    if isinstance(error, RunInterrupted):
        return INTERRUPTED
    if isinstance(error, FrameDamaged):
        return DEVICE
    usage = GroundError | TracerError | CorrectionError | RunUsageError | StageUsageError | CameraUsageError
    if isinstance(error, usage):
        return USAGE
    if isinstance(error, DaqError | StageError):
        return DEVICE
    if (
        isinstance(error, OSError) and error.filename is not None
    ):  # an output folder that cannot be one, a full disk
        return DEVICE if error.errno == errno.ENOSPC else USAGE
    return None


if __name__ == "__main__":
    sys.exit(main())
