"""Pairs of several cameras that were exposed by the same trigger, each camera's in its own order.

Every camera loses pairs of its own, and one lost pair would shift all behind it, so pairs are never put together
by counting.  All cameras hang on one trigger line; on the computer's clock their exposures A of one trigger begin
together, within what is known of their clocks (a millisecond), and those of neighbouring triggers a whole period
apart.  So two pairs are of one trigger if they are nearer than a quarter of the period, and of different ones if
they are farther than three quarters.  What lies between cannot be, if the clocks are right: then nothing is kept.

A pair that another camera has not is dropped as soon as that camera has gone past it.
"""

from collections import deque
from collections.abc import Generator, Sequence

from daq.runner.chunk import Chunk
from daq.runner.pair_source import Pair, PairSource
from daq.runs.chunk_books import ELSEWHERE, LEFT

SAME, OTHER = 0.25, 0.75  # of the period

Stream = Generator[Pair | None, None, None]


def together(
    sources: Sequence[PairSource], streams: Sequence[Stream], chunks: Sequence[Chunk], rate_hz: float
) -> Generator[tuple[Pair, ...], None, None]:
    """Yield pairs of one trigger, a pair a camera, in order.

    Parameters
    ----------
    sources, streams, chunks : sequence
        Of each camera: itself, what its `pairs` returned, and its books.
    rate_hz : float
        Triggers a second.

    Raises
    ------
    FrameDoubt
        The cameras' clocks do not say which frames belong together.
    """
    if len(sources) == 1:
        for pair in streams[0]:
            if pair is not None:
                yield (pair,)
        return
    waiting: list[deque[tuple[int, Pair]]] = [deque() for _ in sources]
    is_over = [False] * len(sources)
    try:
        while not all(is_over):
            for number, (source, stream) in enumerate(zip(sources, streams, strict=True)):
                if is_over[number]:
                    continue
                try:
                    pair = next(stream)
                except StopIteration:
                    is_over[number] = True
                    continue
                if pair is not None:
                    waiting[number].append((0, pair))  # given back below, whatever its clock says
                    waiting[number][-1] = (source.host_ns(pair), pair)
            while all(waiting):
                if (found := _first_of_all(sources, waiting, chunks, 1e9 / rate_hz)) is not None:
                    yield found
    finally:
        for source, chunk, left in zip(sources, chunks, waiting, strict=True):
            why = ELSEWHERE if all(is_over) else LEFT
            for _, pair in left:
                source.drop(chunk, why, *pair)


def _first_of_all(
    sources: Sequence[PairSource],
    waiting: Sequence[deque[tuple[int, Pair]]],
    chunks: Sequence[Chunk],
    period_ns: float,
) -> tuple[Pair, ...] | None:
    """Take the earliest pairs: those of one trigger, or None and the ones that another camera has not are gone."""
    latest_ns = max(queue[0][0] for queue in waiting)
    apart = [(latest_ns - queue[0][0]) / period_ns for queue in waiting]
    unclear = [source.name for source, share in zip(sources, apart, strict=True) if SAME < share < OTHER]
    if unclear:
        beside_ms = 1e-6 * period_ns * max(apart)
        sources[0].exposures.doubt(
            f"frames of {unclear[0]} lie {beside_ms:.1f} ms beside those of another camera, which "
            "is neither the same trigger nor another one: a clock is not what it says, or a trigger line is loose"
        )
    if max(apart) <= SAME:
        return tuple(queue.popleft()[1] for queue in waiting)
    for source, chunk, queue, share in zip(sources, chunks, waiting, apart, strict=True):
        if share >= OTHER:
            source.drop(chunk, ELSEWHERE, *queue.popleft()[1])
    return None
