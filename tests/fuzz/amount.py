"""How much the slow tests of this folder play, of which seed: `make fuzz SEQUENCES=100000 CASES=100000 SEED=2`."""

import os

PATIENCE_S = 0 if os.environ.get("FUZZ_SEED") else 7200  # who has asked for more waits for it


def sequences(usual):
    """So many sequences on benches, or the number that was asked for."""
    return int(os.environ.get("FUZZ_SEQUENCES") or usual)


def cases(usual):
    """So many damaged files and command lines, or the number that was asked for."""
    return int(os.environ.get("FUZZ_CASES") or usual)


def seed(usual):
    """This seed, or the one that was asked for."""
    return os.environ.get("FUZZ_SEED") or usual
