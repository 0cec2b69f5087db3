"""The player tells the witness what the fixture of all other tests would tell it, so here that one is silent."""

import pytest


@pytest.fixture(autouse=True)
def witnesses():
    """Nothing is collected."""
