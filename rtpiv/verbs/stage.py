"""`rtpiv bench stage`: show, home, move or jog axes, once or from a prompt.

The prompt takes one verb a line.  At a terminal an error prints one sentence and the prompt returns.  Ctrl-C stops
all motion and holds the bench; the prompt says so, and how to go on.  A second Ctrl-C with nothing in between,
Ctrl-D or `quit` ends it.

From a pipe (`rtpiv bench stage < first-day.txt`) the lines are executed in order and echoed; the first error ends
it with its exit code, so a script never continues from a position that it did not reach.
"""

import contextlib
import math
import sys
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Literal

from daq.bench.bench_session import BenchSession, open_session
from daq.errors import DaqError, RunUsageError
from ground.errors import GroundError
from ground.terminal import console, error_console
from rtpiv.analysis.report.table import ALL_COLUMNS, Table
from rtpiv.verbs.operator import TerminalOperator, operator_of
from rtpiv.verbs.paths import Named
from stages.errors import StageError
from tracer.errors import TracerError

CURABLE = (StageError, DaqError, GroundError, TracerError)
COMMENT = "#"


def stage(
    action: Literal["session", "where", "home", "move", "jog"] = "session",
    axes: Sequence[str] = (),
    /,
    bench: Named = "bench.yaml",
    simulate: bool = False,
    home: bool = False,
) -> dict[str, float | None]:
    """Look at axes or move them.

    Parameters
    ----------
    action : {"session", "where", "home", "move", "jog"}
        `session` reads verbs from the terminal or from a pipe.
    axes : sequence of str
        ``name=mm`` to move to, ``name=mm`` to jog by, names to home (default all); ignored by `where`.
    bench : path
        bench.yaml.
    simulate : bool
        Use the simulation of the bench.
    home : bool
        Home every axis first, in the configured order: isel and Grbl lose their reference with every program.

    Returns
    -------
    dict
        Where every axis is afterwards [mm]; None where it is not known.

    Raises
    ------
    StageUsageError
        Out of limits, obstructed, or not homed; nothing has moved.
    """
    named, say = list(axes), error_console()
    wanted = numbers(named) if action in ("move", "jog") else {}

    def tell(axis: str) -> None:
        say.print(f"homing {axis}")

    with open_session(bench, simulate) as session:
        if not simulate:
            session.stage.set_operator(operator_of(None, simulate).reads)
        if home:
            session.home(tell=tell)
        if action == "session":
            Prompt(session).run()
            return session.where()
        if action == "home":
            session.home(*named, tell=tell)
        elif action == "move":
            session.move(**wanted)
        elif action == "jog":
            session.jog(**wanted)
        shown, where = where_table(session), session.where()
    console().print(shown)
    return where


def where_table(session: BenchSession) -> Table:
    """Return the positions of all axes as a table."""
    rows = []
    for name, mm in session.where().items():
        about = session.bench.table.stages.axes[name]
        low, high = about.limits_mm
        shown = f"{mm:.4f}" if mm is not None else "unknown"
        state = session.stage.axis(name).state.value
        rows.append((name, about.carries, about.along, shown, state, f"{low:g} to {high:g}"))
    return Table("", ("axis", "carries", "along", "mm", "state", "limits"), rows, left=ALL_COLUMNS)


def numbers(named: list[str]) -> dict[str, float]:
    """Return the positions or distances in ``axis=mm`` words.

    Raises
    ------
    RunUsageError
        A word is something else, an axis is named twice, or there is none.
    """
    found: dict[str, float] = {}
    for text in named:
        name, equals, value = text.partition("=")
        try:
            mm = float(value) if equals else math.nan
        except ValueError:
            mm = math.nan
        if not math.isfinite(mm):
            raise RunUsageError(f"{text!r}: give axis=mm, as in target_x=1.5")
        if name in found:
            raise RunUsageError(f"{name} is named twice; give it once")
        found[name] = mm
    if not found:
        raise RunUsageError("give at least one axis=mm")
    return found


class Prompt:
    """Reads verbs and carries them out.

    Parameters
    ----------
    session : BenchSession
        Open.
    """

    def __init__(self, session: BenchSession) -> None:
        self._session = session
        self._screen = console()
        self._talks = sys.stdin.isatty()
        self._goes_on = True
        verbs: tuple[tuple[str, str, Callable[[list[str]], None]], ...] = (
            ("home [AXIS ...]", "find the references, all or some, in the configured order", self._home),
            ("confirm AXIS=MM ...", "where axes stand that are homed by hand", self._confirm),
            ("where", "where every axis is", self._where),
            ("move AXIS=MM ...", "go to positions, one axis after the other", partial(self._go, session.move)),
            ("jog AXIS=MM ...", "go by distances", partial(self._go, session.jog)),
            ("stop", "stop everything and hold the bench, as Ctrl-C does", self._stop),
            ("clear", "let a held bench move again: you have looked at it", lambda words: session.clear()),
            ("connect [CONTROLLER ...]", "open a controller that was lost; home its axes then", self._connect),
            ("here [AXIS ...]", "the bench stands now as the scene file says", self._here),
            ("save", "write that, and the boxes' identities, into the bench file", self._save),
            ("help", "this", self._help),
            ("quit", "close everything and leave (or Ctrl-D)", self._quit),
        )
        self._verbs = {shown.partition(" ")[0]: (shown, text, do) for shown, text, do in verbs}

    def run(self) -> None:
        """Read and obey until the end.

        Raises
        ------
        KeyboardInterrupt
            Ctrl-C was pressed twice.
        StageError, DaqError, GroundError, TracerError
            From a pipe: what went wrong first.
        """
        if self._talks:
            self._talk()
        else:
            for number, line in enumerate(sys.stdin, start=1):
                try:
                    self._say(f"> {line.strip()}")
                    self.obey(line)
                except CURABLE:
                    print(f"line {number}: {line.strip()}", file=sys.stderr)
                    raise
                if not self._goes_on:
                    return

    def obey(self, line: str) -> None:
        """Carry one line out.

        Raises
        ------
        RunUsageError
            There is no such verb, or its words make no sense.
        StageError, DaqError, GroundError, TracerError
            What came between.
        """
        name, *words = line.partition(COMMENT)[0].split() or [""]
        if not name:
            return
        verb = self._verbs.get("quit" if name == "exit" else name)
        if verb is None:
            raise RunUsageError(f"there is no verb {name!r}; there are {', '.join(self._verbs)}")
        shown, _, do = verb
        if words and "[" not in shown and "=" not in shown:
            raise RunUsageError(f"{name} takes no further words, not {' '.join(words)!r}")
        do(words)

    def _say(self, text: str) -> None:
        self._screen.print(text, highlight=False, soft_wrap=True)

    # ---- a person ------------------------------------------------------------------------------

    def _talk(self) -> None:
        self._say(f"{self._session.bench.table.name} is open; `help` lists the verbs, Ctrl-C stops and holds")
        presses = 0
        with self._completion():
            while self._goes_on:
                try:
                    line = input("held> " if self._session.held else "stage> ")
                    self.obey(line)
                    presses = 0
                except EOFError:
                    self._say("")
                    return
                except KeyboardInterrupt:
                    presses += 1
                    torn = any(box.under_way for box in self._session.stage.controllers.values())
                    if presses > 1 or torn:  # torn: the second one came before the motion had ended
                        raise
                    self._say("\nstopped; the bench is held: look at it, then `clear`. Ctrl-C again leaves")
                except CURABLE as error:
                    self._say(str(error))

    @contextlib.contextmanager
    def _completion(self) -> Iterator[None]:
        """History and completion of verbs and axes, where the system has them."""
        try:
            import readline
        except ImportError:
            yield
            return
        before = readline.get_completer()
        readline.set_completer(self._complete)
        readline.parse_and_bind("tab: complete")
        try:
            yield
        finally:
            readline.set_completer(before)

    def _complete(self, text: str, state: int) -> str | None:
        words = [*self._verbs, *self._session.stage.axes, *self._session.stage.controllers]
        found = [word for word in words if word.startswith(text)]
        return found[state] if state < len(found) else None

    # ---- verbs ---------------------------------------------------------------------------------

    def _home(self, words: list[str]) -> None:
        say = error_console()
        ask = TerminalOperator().stands_mm if self._talks else None
        self._session.home(*words, tell=lambda axis: say.print(f"homing {axis}"), ask=ask)
        self._where([])

    def _confirm(self, words: list[str]) -> None:
        self._session.confirm(**numbers(words))
        self._where([])

    def _where(self, words: list[str]) -> None:
        self._screen.print(where_table(self._session))

    def _go(self, act: Callable[..., object], words: list[str]) -> None:
        act(**numbers(words))
        where = self._session.where()
        for name in numbers(words):
            mm = where[name]
            self._say(f"{name} is at {mm:.4f} mm" if mm is not None else f"{name} is unknown")

    def _stop(self, words: list[str]) -> None:
        self._session.stop()
        self._say("stopped; the bench is held: look at it, then `clear`")

    def _connect(self, words: list[str]) -> None:
        opened = self._session.connect(*words)
        self._say(f"opened {', '.join(opened)}; home its axes" if opened else "nothing was lost")

    def _here(self, words: list[str]) -> None:
        for name, mm in self._session.here(*words).items():
            self._say(f"the scene file holds at {name} {mm:.4f} mm")
        self._say("`save` writes it into the bench file")

    def _save(self, words: list[str]) -> None:
        path, changes = self._session.bench.path, self._session.changes()
        if not changes:
            self._say(f"{path} holds these values already")
            return
        self._say(changes)
        if self._talks and input(f"write this into {path.name}? [y/N] ").strip().lower() not in ("y", "yes"):
            self._say("nothing was written")
            return
        kept = self._session.save()
        self._say(f"written; the old file is {kept}")

    def _help(self, words: list[str]) -> None:
        wide = max(len(shown) for shown, _, _ in self._verbs.values())
        for shown, text, _ in self._verbs.values():
            self._say(f"  {shown:{wide}}  {text}")

    def _quit(self, words: list[str]) -> None:
        self._goes_on = False
