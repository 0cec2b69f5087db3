"""Forking of a process that has one thread: the child starts with its modules, loaded kernels and maps.

A forked copy holds every lock that another thread held at that moment, for ever (fork(2)).  So a process forks
only on Linux and only while its first thread is its only one, by the count of the system, which knows threads of
libraries as well.
"""

import signal
import sys
import threading
import time
from pathlib import Path

import ground.jit.compile_news as compile_news
from ground.rows import end_idle_threads

ENDINGS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
TASKS = Path("/proc/self/task")
LOOKS, LOOK_S = 20, 0.005


def can_fork() -> bool:
    """Return whether this process may be forked; ends idle threads, which begin anew later."""
    if sys.platform != "linux" or threading.current_thread() is not threading.main_thread():
        return False
    end_idle_threads()
    opencv = sys.modules.get("cv2")
    if opencv is not None:
        threads = opencv.getNumThreads()
        opencv.setNumThreads(1)  # joins its threads; they begin again when they are needed
        opencv.setNumThreads(threads)
    # A thread that has been joined is still there for the system until it has left
    for _ in range(LOOKS):
        if len(list(TASKS.iterdir())) == 1:
            break
        time.sleep(LOOK_S)
    else:
        return False
    return threading.active_count() == 1


def begin_child() -> None:
    """Forget in a forked child what its parent set up for itself: handlers of signals, and news for a person."""
    for number in ENDINGS:
        signal.signal(number, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, ENDINGS)
    compile_news.watch = compile_news.complain = compile_news.make_helper = compile_news.helper = None
