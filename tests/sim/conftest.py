"""The witness of simulated benches."""

from tests.watched_benches import witnesses

__all__ = ["witnesses"]
