"""The way of a move, piece by piece, and who judges it before it is driven."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol


@dataclass(frozen=True, slots=True)
class Piece:
    """One axis moving while the others rest: part of the way of a move."""

    axis: str
    start_mm: float
    end_mm: float
    others_mm: Mapping[str, float]  # every axis, this one included at its start


class Guard(Protocol):
    """Judges a way before it is driven; `daq.bench.keep_out.KeepOut` is one."""

    def check(self, way: Sequence[Piece]) -> None:
        """Raise `Obstructed` if the way must not be driven."""
