"""The command line: it calls a verb and returns an exit code, with one sentence for an error.

Every command is a public function in ``rtpiv.verbs``, listed by name in `rtpiv.options.command` (`GROUPS`) and
imported only when it is called, so that ``rtpiv --help`` answers at once.  Exit codes and their sentences:
`rtpiv.command_line.exit_codes`.
"""

import importlib
import os
import signal
import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from io import TextIOWrapper
from typing import Any, TextIO

import ground.jit.compile_news as compile_news
from daq.signal_handling import SIGNALLED, flush_or_leave, handle_signals
from ground.errors import RtpivWarning, UntrustedProgram
from ground.named_program import VARIABLE, trust
from ground.printable import printable
from rtpiv.analysis.pictures.own_style import ENVIRONMENT
from rtpiv.command_line.exit_codes import DEVICE as DEVICE  # for callers of main
from rtpiv.command_line.exit_codes import DONE as DONE
from rtpiv.command_line.exit_codes import INTERRUPTED as INTERRUPTED
from rtpiv.command_line.exit_codes import USAGE as USAGE
from rtpiv.command_line.exit_codes import exit_code, sentence
from rtpiv.options.command import call_of, current, parser
from rtpiv.options.near import near_option

THREADS = ("RTPIV_THREADS", "OMP_NUM_THREADS", "OPENCV_FOR_THREADS_NUM")
# Matrices are narrow here: shared by cores they take longer, and the last bits of a sigma depend on the computer.
ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1"}
NO_PLUGINS = {"PYDANTIC_DISABLE_PLUGINS": "__all__"}  # it would search all installed packages


PICTURES = "rtpiv.analysis.pictures"
KERNELS = "ground.jit.compiler"  # numba, which drawing rays needs as well
KEEPS = ("calibrate", "campaign", "check", "correct", "evaluate", "mean", "report", "trace")  # freed memory
DRAWS = {  # verb -> modules for drawing, imported while it computes
    "trace": (f"{PICTURES}.traced", f"{PICTURES}.drawing", "cv2", KERNELS),
    "compare": (f"{PICTURES}.results",),
    "correct": (f"{PICTURES}.results", "cv2"),
    "evaluate": ("rtpiv.analysis.report.pair", "rtpiv.analysis.report.page", KERNELS),
    "calibrate": (f"{PICTURES}.calibration", "rtpiv.analysis.report.calibration"),
}


def _options(arguments: Sequence[str]) -> dict[str, Any]:
    """Read the words of a command; axes may also follow options, where argparse expects none."""
    given, notice = current(arguments)
    if notice:
        print(notice, file=sys.stderr)
        if not given:
            raise SystemExit(USAGE)
    words = parser(given)
    known, left = words.parse_known_args(given)
    options = vars(known)
    refuse = options.pop("refuse", words.error)
    if left and options["verb"] == "stage" and not any(word.startswith("-") for word in left):
        options["axes"] = [*options["axes"], *left]
    elif left:
        several = "one is wanted here, and more are given: " if all(map(os.path.exists, left)) else ""
        hint = "" if several else near_option(getattr(refuse, "__self__", words), left[0])
        refuse(printable(f"{several or 'unrecognized arguments: '}{' '.join(left)}{hint}"))
    return options


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one verb; return the exit code."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):  # a letter that the terminal lacks is escaped
            stream.reconfigure(errors="backslashreplace")
    options = _options(sys.argv[1:] if arguments is None else arguments)
    verb, threads, trusted = options.pop("verb"), options.pop("threads"), options.pop("trust")
    command = f"rtpiv {options.pop('command', '')}"
    if verb is None:
        parser(()).print_help()
        return USAGE
    if trusted is not None:  # for children as well
        os.environ[VARIABLE] = ",".join(filter(None, (os.environ.get(VARIABLE), trusted)))
    os.environ.update(ONE_THREAD | NO_PLUGINS | os.environ | ENVIRONMENT)
    if threads is not None:
        os.environ.update(dict.fromkeys(THREADS, str(threads)))  # for children as well; no library is loaded yet
    compile_news.watch = print_compiling
    compile_news.complain = lambda complaint: print(f"{command}: {complaint}", file=sys.stderr)
    compile_news.make_helper, compile_news.helper = lambda: _first_use(verb), None
    with handle_signals(), _without_helper(), warnings.catch_warnings():
        warnings.showwarning = print_warning
        try:
            code = _run_verb(verb, options, command)
            if code is None:  # the user now trusts the programs of the bench file
                code = _run_verb(verb, options, command) or DONE
        except SystemExit as end:
            if isinstance(end.code, int) and end.code > SIGNALLED:
                print(f"{command}: ended by {signal.Signals(end.code - SIGNALLED).name}", file=sys.stderr)
            raise
        failed = flush_or_leave()
    if failed is not None and code == DONE:
        print(f"{command}: {sentence(failed)}", file=sys.stderr)
        return DEVICE
    return code


def _drawing_process(modules: Sequence[str]) -> AbstractContextManager[None]:
    """Start a process that draws pictures, if there are modules for it.

    It is forked from this one, so modules that both need are imported first.
    """
    if not modules:
        return nullcontext()
    if KERNELS in modules:
        importlib.import_module(KERNELS)
    from rtpiv.analysis.pictures.drawing_process import drawing_apart

    return drawing_apart(modules)


def _first_use(verb: str) -> compile_news.Helper:
    """Return the helper of a verb whose kernels are not compiled yet."""
    from rtpiv.command_line.first_use import FirstUse

    return FirstUse(verb)


@contextmanager
def _without_helper() -> Iterator[None]:
    """End the helper of the compiler with the verb."""
    try:
        yield
    finally:
        end = getattr(compile_news.helper, "end", None)
        if end is not None:
            end()
        compile_news.make_helper = compile_news.helper = None


def _run_verb(verb: str, options: dict[str, Any], command: str) -> int | None:
    """Run a verb; return the exit code, or None to run it again, as the user now trusts its bench file."""
    try:
        if verb in KEEPS:
            from ground.kept_memory import keep_memory

            keep_memory()
        function = getattr(importlib.import_module(f"rtpiv.verbs.{verb}"), verb)
        words, named = call_of(verb, options)
        with _drawing_process(DRAWS.get(verb, ()) if options.get("pictures") else ()):
            function(*words, **named)
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return INTERRUPTED
    except UntrustedProgram as error:
        if _is_trusted_now(error):
            return None
        print(f"{command}: {sentence(error)}", file=sys.stderr)
        return USAGE
    except Exception as error:
        code = exit_code(error)
        if code is None:
            raise
        print(f"{command}: {sentence(error, options.get('out'))}", file=sys.stderr)
        return code
    return DONE


def _is_trusted_now(error: UntrustedProgram) -> bool:
    """Ask at the terminal whether programs may be called; a yes is stored."""
    if not (sys.stdin is not None and sys.stdin.isatty() and sys.stderr.isatty()):
        return False
    names = printable(", ".join(error.names))
    print(f"The bench file names {names}. It would be called, and can do whatever you can.", file=sys.stderr)
    print("Do you trust who wrote the file? Type yes: ", end="", file=sys.stderr, flush=True)
    if sys.stdin.readline().strip().casefold() != "yes":
        return False
    trust(error.names)
    return True


def print_warning(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: TextIO | None = None,
    line: str | None = None,
) -> None:
    """Print a warning of rtpiv without file and line, control characters escaped.

    Warnings of libraries are for developers: Python's option -W or PYTHONWARNINGS prints them.
    """
    if issubclass(category, RtpivWarning) or sys.warnoptions:
        print(f"rtpiv: {printable(str(message))} ({category.__name__})", file=sys.stderr)


def print_compiling(functions: int, seconds: float) -> None:
    """Report on standard error that kernels are being compiled, once on each computer."""
    if functions == 0:
        text = f"compiling, first use on this computer{_why_not_shipped()}, one to three minutes in all"
    else:
        left = getattr(compile_news.helper, "seconds_left", lambda: None)()
        text = f"compiling: {functions} functions, {seconds:.0f} s"
        text += "" if left is None else f", {max(5, 5 * round(left / 5))} s more at least"
    print(text, file=sys.stderr, flush=True)


def _why_not_shipped() -> str:
    """Return the numba version of the machine code in this wheel if another one is installed."""
    import numba

    from ground.jit.shipped import FOLDER, other_numba

    made_by = other_numba(numba.__version__, FOLDER)
    if made_by is None:
        return ""
    return f" (the machine code of this wheel is for numba {made_by}, not {numba.__version__})"


if __name__ == "__main__":
    sys.exit(main())
