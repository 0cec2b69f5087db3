"""What Python lacks on a system without POSIX (Windows), hidden from our packages.

Everybody else, tests and libraries, sees the system as it is: they have code of their own for Windows. Its
names are other than any that exist, so code that asks for Windows does not run; paths, ports and processes stay
those of this computer. Of what Windows has instead, locks of bytes are there, as its manual has `_locking`.
"""

import builtins
import errno
import fcntl
import os
import signal
import socket
import struct
import sys
from types import ModuleType
from typing import Any

PACKAGES = ("correction", "daq", "ground", "piv", "rtpiv", "sim", "stages", "tracer")
MODULES = ("fcntl", "grp", "pty", "pwd", "resource", "syslog", "termios", "tty")
FUNCTIONS = {
    "os": ("fork", "getgid", "getloadavg", "getegid", "geteuid", "getsid", "getuid", "initgroups", "killpg",
           "mkfifo", "nice", "openpty", "posix_fadvise", "posix_fallocate", "pread", "pwrite", "register_at_fork",
           "sched_getaffinity", "setpgid", "setpriority", "setsid", "statvfs", "sysconf", "uname", "wait4",
           "waitid"),
    "signal": ("SIGALRM", "SIGHUP", "SIGKILL", "SIGQUIT", "SIGSTOP", "SIGTSTP", "SIGUSR1", "SIGUSR2", "alarm",
               "pthread_sigmask", "setitimer", "sigwait"),
    "socket": ("AF_UNIX",),
    "sys": (),
}  # fmt: skip
ELSEWHERE = {"os": {"name": "elsewhere"}, "sys": {"platform": "elsewhere"}}


class Lacking(ModuleType):
    """A module but for what another system does not have; what is changed in it is changed in the real one."""

    def __init__(self, real: ModuleType) -> None:
        super().__init__(real.__name__)
        self.__dict__["_real"] = real

    def __getattr__(self, name: str) -> Any:
        if name in FUNCTIONS[self.__name__]:
            raise AttributeError(f"module {self.__name__!r} has no attribute {name!r} on this system")
        elsewhere = ELSEWHERE.get(self.__name__, {})
        return elsewhere[name] if name in elsewhere else getattr(self.__dict__["_real"], name)

    def __setattr__(self, name: str, value: Any) -> None:
        setattr(self.__dict__["_real"], name, value)

    def __delattr__(self, name: str) -> None:
        delattr(self.__dict__["_real"], name)


def locking(descriptor: int, mode: int, count: int) -> None:
    """Lock so many bytes from where a file stands, for this very opening of it, or say EACCES at once."""
    assert mode == MSVCRT.LK_NBLCK
    is_read_only = fcntl.fcntl(descriptor, fcntl.F_GETFL) & os.O_ACCMODE == os.O_RDONLY
    kind = fcntl.F_RDLCK if is_read_only else fcntl.F_WRLCK
    asked = struct.pack("hhqqi", kind, os.SEEK_CUR, 0, count, 0)
    try:
        fcntl.fcntl(descriptor, fcntl.F_OFD_SETLK, asked)
    except BlockingIOError as error:
        raise PermissionError(errno.EACCES, "Permission denied") from error


MSVCRT = ModuleType("msvcrt")
MSVCRT.LK_NBLCK, MSVCRT.locking = 2, locking  # type: ignore[attr-defined]
LACKING = {module.__name__: Lacking(module) for module in (os, signal, socket, sys)}
before = builtins.__import__


def imported(name: str, globals: Any = None, locals: Any = None, fromlist: Any = (), level: int = 0) -> Any:
    """Import as Python does, but for a module of ours that asks for what is hidden."""
    asks = str((globals or {}).get("__name__", "")).partition(".")[0]
    if asks in PACKAGES and name == MSVCRT.__name__:
        return MSVCRT
    whole = before(name, globals, locals, fromlist, level)
    if level or asks not in PACKAGES:
        return whole
    if name.partition(".")[0] in MODULES:
        raise ModuleNotFoundError(f"No module named {name!r}", name=name)
    return LACKING.get(name if fromlist else name.partition(".")[0], whole)


def hide() -> None:
    """From now on, in this process."""
    builtins.__import__ = imported
