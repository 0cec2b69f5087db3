"""Results written while the next ones are made: by a thread of its own, which holds one."""

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from types import TracebackType
from typing import Self


class WriteBehind:
    """Carries out one call after the other beside its caller, in their order.

    A call that fails ends what was to come: `write`, or the end of the block, raises its error, and nothing more
    begins.
    """

    def __init__(self) -> None:
        self._writer = ThreadPoolExecutor(1, "rtpiv-results")
        self._last: Future[None] | None = None

    def write(self, call: Callable[[], None]) -> None:
        """Wait until the last call is done, then begin this one."""
        self._done()
        self._last = self._writer.submit(call)

    def _done(self) -> None:
        last, self._last = self._last, None
        if last is not None:
            last.result()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if error is None:
                self._done()
        finally:
            self._writer.shutdown(wait=True)  # what has begun is whole; of another error that one is told
