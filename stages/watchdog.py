"""A small process that stops what moves when this one has died without a word.

Signals and exceptions are met where they happen (`stages.stop_signals`). What no handler meets (kill -9, a
segfault, out of memory, `os._exit`) leaves controllers that drive on to their targets unattended. So
a program that opens real ports starts a process that holds nothing but one end of a pipe, and tells it

    {"know": "rail", "url": "/dev/ttyUSB0", "baud": 19200, "hold_dtr": false, "stop": ["fd"],
     "file": [48128, 512, 0]}
    {"moves": "rail"}      before the first byte that can move
    {"rests": "rail"}      when the end of the motion has been heard of

When the pipe ends, or the parent has died although a forked child of it still holds the pipe, whatever is said to
move is stopped: the port is opened, its stop bytes are written, and said again a few times, because a stop that
overtakes an unread command stops nothing. Then the process ends. If nothing moves it just ends: a goodbye is not
needed, and a program that forgets one leaves nothing that drives on.

The process imports nothing but pyserial and the standard library, so it is up in a fraction of a second and shares
no fate with numba, a camera library or a full memory. It has a session of its own, so that Ctrl-C and the end of
the terminal pass it by, and it ignores SIGTERM: at a shutdown the parent must end first. It is started, never
waited for; messages sent before it is up wait in the pipe.

The port's lock is asked for only while the rate is set. If another process holds it (a child that inherited the
port, or a program that opened it since), the rate is set already, and the bytes are written without it: a stop is
whole in one write, and harmless at rest.

A name is not a box: what was pulled out may be followed by another box under the same name, and that one is not
ours to stop. So what the device file was when it was opened (device number and inode) is sent as "file", and a
port that has become another one is left alone. Pseudo-terminals alone are identified by the time of their making
too: they get used inodes, and udev, which touches the time stamps of real ports at will, knows nothing of them.
The stamp is as fine as the kernel's tick (1 to 10 ms): no plug can be pulled and another terminal made within one.

Out of reach: a process that is stopped (SIGSTOP, a debugger) has not died. There is no heartbeat that would take
it for dead, because a computer that swaps or compiles is silent for seconds too, and a stop in vain ends a run.
What had begun goes to its target, which was judged before, and nothing else begins. Nor can anything be done when
the computer itself loses its power, or when the whole control group is killed at once.
"""

import contextlib
import json
import os
import select
import signal
import subprocess
import sys
import threading
import time
import warnings
from collections.abc import Callable, Sequence
from typing import Any

import serial

AGAIN_S = (0.0, 0.03, 0.08, 0.2, 0.5)  # after the death, or after the port could be opened
OPEN_PATIENCE_S = 10.0  # with a port that cannot be opened
RETRY_S = 0.05
SHORT_LIFE_S = 1.0  # one that dies sooner is replaced with the next word only, or it might go on for ever
PARENT_POLL_S = 0.1  # how often the parent is looked for where the system does not tell
# elsewhere a read waits for a word, and only the end of the pipe tells a death
SELECTS_PIPES = os.name == "posix"
PSEUDO_TERMINALS = range(136, 144)  # major numbers of Unix98 slaves on Linux
WITHOUT_DEVICE = ("sim://", "loop://")  # these die with their process

Word = dict[str, Any]


def needs_watchdog(urls: Sequence[str]) -> bool:
    """Return whether any of these ports outlives the process that opens it."""
    return any(not url.startswith(WITHOUT_DEVICE) for url in urls)


def word_of(name: str, url: str, baud: int, hold_dtr: bool, stop_bytes: Sequence[bytes]) -> Word:
    """Return what `stop` must know of a port, as it is now; arguments as of `Watchdog.know`."""
    stop = [data.hex() for data in stop_bytes]
    return {"know": name, "url": url, "baud": baud, "hold_dtr": hold_dtr, "stop": stop, "file": _file_of(url)}


class Watchdog:
    """The living end of the pipe: starts the process and tells it what moves. Safe for several threads.

    A process that is killed is missed at once: another one takes its place, and `on_loss` is called, because what
    moved meanwhile was not watched.

    Parameters
    ----------
    on_loss : callable, optional
        Called with the reason, from a thread of its own.
    """

    def __init__(self, on_loss: Callable[[str], object] | None = None) -> None:
        self._on_loss = on_loss
        self._is_closed = False
        self._known: dict[str, Word] = {}
        self._moving: set[str] = set()
        self._lock = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self._start()

    @property
    def pid(self) -> int | None:
        """Process id; None if it could not be started."""
        return None if self._process is None else self._process.pid

    def know(self, name: str, url: str, baud: int, hold_dtr: bool, stop_bytes: Sequence[bytes]) -> None:
        """Say how a controller is stopped.

        Parameters
        ----------
        name : str
            What the bench file calls it.
        url : str
            Its port, as pyserial takes it.
        baud : int
            Its rate.
        hold_dtr : bool
            Whether DTR is kept low on opening.
        stop_bytes : sequence of bytes
            What stops any motion; each is written whole.
        """
        if not needs_watchdog([url]):
            return
        with self._lock:
            self._known[name] = word_of(name, url, baud, hold_dtr, stop_bytes)
            self._tell(self._known[name])

    def moves(self, name: str) -> None:
        """Say that a controller may move from now on; called before the first byte that can move."""
        with self._lock:
            if name in self._known and name not in self._moving:
                self._moving.add(name)
                self._tell({"moves": name})

    def rests(self, name: str) -> None:
        """Say that a controller is known to be at rest."""
        with self._lock:
            if name in self._moving:
                self._moving.discard(name)
                self._tell({"rests": name})

    def close(self) -> None:
        """End the pipe; what is still said to move will be stopped."""
        with self._lock:
            self._is_closed = True
            if self._process is not None:
                process, self._process = self._process, None
                _end(process)

    def _start(self) -> None:
        # not -m: a folder called `stages` where the program was started must not be taken for ours
        command = [sys.executable, "-P", __file__, str(os.getpid())]
        quiet = subprocess.DEVNULL
        apart: dict[str, Any] = {"start_new_session": True}
        if sys.platform == "win32":  # Ctrl-C and Ctrl-Break go to a group of processes
            apart = {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP}
        try:
            self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=quiet, stderr=quiet, **apart)
        except OSError as error:
            self._process = None
            text = f"there is no watchdog ({error}): if this program is killed, what moves drives on to its target"
            from ground.errors import RtpivWarning  # the watchdog itself is this file alone

            warnings.warn(text, RtpivWarning, stacklevel=2)
            return
        assert self._process.stdin is not None
        if SELECTS_PIPES:
            # a watchdog that hangs must not hang the bench
            os.set_blocking(self._process.stdin.fileno(), False)
        threading.Thread(target=self._miss, args=(self._process,), name="watchdog's death", daemon=True).start()

    def _miss(self, process: "subprocess.Popen[bytes]") -> None:
        """Wait for the end of a process; if that was not ours to bring about, replace it and say so."""
        begun_s = time.monotonic()
        process.wait()
        with self._lock:
            if self._is_closed:
                return
            if process is self._process and time.monotonic() - begun_s > SHORT_LIFE_S:
                self._replace(process)
        if self._on_loss is not None:
            self._on_loss("the watchdog of this program was killed")

    def _replace(self, process: "subprocess.Popen[bytes]") -> None:
        """Start another process, and tell it everything."""
        self._process = None
        _end(process)
        self._start()
        self._write([*self._known.values(), *({"moves": name} for name in sorted(self._moving))])

    def _tell(self, word: Word) -> None:
        if self._process is None or self._write([word]):
            return
        self._replace(self._process)  # it was killed

    def _write(self, words: Sequence[Word]) -> bool:
        """Write words, each whole or not at all; False if the reader is gone."""
        if self._process is None or self._process.stdin is None:
            return False
        for word in words:
            try:
                os.write(self._process.stdin.fileno(), json.dumps(word).encode() + b"\n")
            except BlockingIOError:  # it hangs with a full pipe; it knows enough to stop at the end
                return True
            except OSError:
                return False
        return True


def _end(process: "subprocess.Popen[bytes]") -> None:
    """Close the pipe, and take the exit status whenever it comes."""
    if process.stdin is not None:
        with contextlib.suppress(OSError):
            process.stdin.close()
    threading.Thread(target=process.wait, name="watchdog's end", daemon=True).start()


# ---- the process -------------------------------------------------------------------------------


def watch(parent: int) -> None:
    """Read words until the parent ends, then stop what moves.

    Parameters
    ----------
    parent : int
        Process id of who started us.
    """
    for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT", "SIGBREAK"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    known: dict[str, Word] = {}
    moving: set[str] = set()
    rest = b""
    descriptor = sys.stdin.fileno()
    if SELECTS_PIPES:
        os.set_blocking(descriptor, False)
    death = _death_of(parent)
    while True:
        died = _has_died(descriptor, death, parent)
        chunk = _read(descriptor)
        if chunk == b"" or (chunk is None and died):
            break
        *lines, rest = (rest + (chunk or b"")).split(b"\n")
        for line in lines:
            _note(json.loads(line), known, moving)
    stoppers = [threading.Thread(target=stop, args=(known[name],)) for name in sorted(moving)]
    for thread in stoppers:
        thread.start()
    for thread in stoppers:
        thread.join()


def stop(about: Word) -> bool:
    """Write the stop bytes of one controller, again and again for a while; return whether they went out.

    Parameters
    ----------
    about : dict
        Its word, as `word_of` makes it.
    """
    end_s = time.monotonic() + OPEN_PATIENCE_S
    said, port = 0, None
    while said < len(AGAIN_S) and time.monotonic() < end_s:
        if _file_of(about["url"]) != about["file"]:
            return said > 0  # unplugged; what has this name now is another box
        try:
            port = _open_port(about) if port is None else port
            for data in about["stop"]:
                port.write(bytes.fromhex(data))
            said += 1
            time.sleep(AGAIN_S[said] - AGAIN_S[said - 1] if said < len(AGAIN_S) else 0.0)
        except Exception:  # busy, full, termios' own: whatever it is, try again
            port = None
            time.sleep(RETRY_S)
    if port is not None:
        with contextlib.suppress(Exception):
            port.close()
    return said > 0


def _file_of(url: str) -> list[int] | None:
    """Identity of a device file; None for a port that has no file, or for none."""
    if "://" in url:
        return None
    try:
        is_now = os.stat(url)  # noqa: PTH116 - pathlib costs time
    except OSError:
        return None
    if not SELECTS_PIPES:
        return None  # a port has no file of its own there
    made_ns = is_now.st_ctime_ns if os.major(is_now.st_rdev) in PSEUDO_TERMINALS else 0
    return [is_now.st_rdev, is_now.st_ino, made_ns]


def _open_port(about: Word) -> Any:  # noqa: ANN401 - pyserial's object, or a bare file
    try:
        port = serial.serial_for_url(
            about["url"], about["baud"], timeout=0.0, write_timeout=1.0, exclusive=True, do_not_open=True
        )
        if about["hold_dtr"]:
            port.dtr = False
        port.open()
    except (OSError, ValueError):
        if "://" in about["url"]:
            raise
        # held by another process, so the rate is set
        return os.fdopen(os.open(about["url"], os.O_WRONLY | os.O_NOCTTY | os.O_NONBLOCK), "wb", buffering=0)
    with contextlib.suppress(OSError, ValueError, AttributeError):  # sockets have no lock
        port.exclusive = False
    return port


def _death_of(parent: int) -> int | None:
    """A descriptor that can be read when the parent has ended; None where the system offers none."""
    try:
        return os.pidfd_open(parent)
    except (AttributeError, OSError):
        return None


def _has_died(descriptor: int, death: int | None, parent: int) -> bool:
    """Wait for a word or for the death of the parent; True if it has died."""
    if not SELECTS_PIPES:
        return False
    wanted = [descriptor] if death is None else [descriptor, death]
    ready, _, _ = select.select(wanted, [], [], PARENT_POLL_S if death is None else None)
    return death in ready if death is not None else os.getppid() != parent


def _read(descriptor: int) -> bytes | None:
    """Read what was received; empty at the end of the pipe, None if there is nothing now."""
    try:
        return os.read(descriptor, 65536)
    except BlockingIOError:
        return None


def _note(word: Word, known: dict[str, Word], moving: set[str]) -> None:
    if "know" in word:
        known[word["know"]] = word
    elif word.get("moves") in known:
        moving.add(word["moves"])
    else:
        moving.discard(str(word.get("rests")))


if __name__ == "__main__":
    watch(int(sys.argv[1]))
