"""What an evaluation gives: of one pair as of many, the same value."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

from piv.files.vector_file import Vectors
from rtpiv.analysis.pairs.evaluation import Evaluation
from rtpiv.analysis.pairs.pair_vectors import joined_vectors
from rtpiv.analysis.series.series_folder import SeriesFolder


@dataclass(frozen=True)
class Evaluated:
    """Pairs that were evaluated.

    Parameters
    ----------
    pairs : int
        How many were asked for.
    failed : mapping of str to str
        Those without vectors by name, and why.
    details : tuple of Evaluation
        What is known of single pairs beyond their vectors: of two frames, of pairs that a stage moved, and of
        every pair where that was asked for (routes, tracks, a known shift).
    series : SeriesFolder, optional
        Where the vectors of pairs that are a time apart lie.
    kept : int
        Pairs that an earlier call had evaluated.
    """

    pairs: int
    failed: Mapping[str, str] = field(default_factory=dict)
    details: tuple[Evaluation, ...] = ()
    series: SeriesFolder | None = None
    kept: int = 0

    @cached_property
    def vectors(self) -> Vectors:
        """Vectors of all pairs as one dataset (t, y, x); of a long series read its chunks one by one instead."""
        if self.series is None:
            return joined_vectors([detail.vectors for detail in self.details])
        keys = self.series.about["keys"]
        return joined_vectors([self.series.vectors(number, key) for number, key in enumerate(keys)])

    @property
    def summary(self) -> str:
        """How many pairs have vectors, in a line."""
        return f"{self.pairs - len(self.failed)} of {self.pairs} pairs have vectors"

    def __str__(self) -> str:
        """How many pairs have vectors, and what each pair says that is known in detail."""
        return "\n".join((self.summary, *map(str, self.details)))

    def _repr_html_(self) -> str:
        """Show a notebook how many pairs have vectors, and these."""
        return f"<p>{self.summary}</p>{self.vectors._repr_html_()}"
