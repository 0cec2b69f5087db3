"""Two threads of one program on a virtual clock, of which only one runs at a time, the same way every time.

The main thread plays; another one moves the stage. Whenever the main thread lets time pass by sleeping, the other
one runs where it is due, until it sleeps itself or ends. `Other.run` lets it run at a place of the main thread's
choice, such as between two bytes of a conversation with another box.
"""

import threading

from tests.fuzz.benches.bench import TrapClock


class TwoThreads(TrapClock):
    """A clock whose sleepers take turns."""

    lives = staticmethod(lambda: None)  # called when time has passed: boxes that act by themselves

    def __init__(self):
        super().__init__()
        self.other = None

    def advance_to(self, time_s):
        super().advance_to(time_s)
        self.lives()

    def sleep_s(self, duration_s):
        other = self.other
        if other is not None and other.is_here:
            other.sleeps_until(self.now_s() + duration_s)
            return
        end_s = self.now_s() + duration_s
        while other is not None and not other.has_ended and other.due_s <= end_s:
            self._pass_to(other.due_s)
            other.run()
        self._pass_to(end_s)

    def _pass_to(self, time_s):
        super().sleep_s(max(0.0, time_s - self.now_s()))
        self.lives()


class Other:
    """The other thread.

    Parameters
    ----------
    clock : TwoThreads
        Whose it is.
    work : callable
        What it does; what that raises is kept in `error`.
    """

    def __init__(self, clock, work):
        self._clock, self._work = clock, work
        self._go, self._back = threading.Semaphore(0), threading.Semaphore(0)
        self._thread = threading.Thread(target=self._run, daemon=True)
        self.due_s = clock.now_s()
        self.has_ended = False
        self.error = None
        clock.other = self
        self._thread.start()

    @property
    def is_here(self):
        return threading.current_thread() is self._thread

    def run(self):
        """Let it run until it sleeps or ends; from the main thread, when it is not running."""
        if not self.has_ended:
            self._go.release()
            self._back.acquire()

    def sleeps_until(self, time_s):
        self.due_s = time_s
        self._back.release()
        self._go.acquire()

    def _run(self):
        self._go.acquire()
        try:
            self._work()
        except BaseException as error:
            self.error = error
        self.has_ended = True
        self._back.release()
