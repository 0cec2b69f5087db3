"""Python's collector rests while numba compiles, and works again as it did before."""

import gc

import pytest
from numba.core import event
from numba.core.errors import TypingError

from ground.jit import OVERLOADED, Kernel


class Looks(event.Listener):
    """Whether the collector works, at the beginning of each pass of the compiler."""

    def __init__(self):
        self.found = []

    def on_start(self, event):
        self.found.append(gc.isenabled())

    def on_end(self, event):
        return


def one_more(x):
    return x + 1


@pytest.mark.parametrize("before", [True, False])
def test_the_collector_rests_while_a_kernel_is_compiled_and_is_then_as_it_was(before):
    looks, whole = Looks(), gc.isenabled()
    (gc.enable if before else gc.disable)()
    try:
        with event.install_listener("numba:run_pass", looks):
            assert Kernel(one_more, OVERLOADED)(1) == 2  # kept in no cache: compiled each time
        assert gc.isenabled() is before
    finally:
        (gc.enable if whole else gc.disable)()
    assert len(looks.found) > 5
    assert not any(looks.found)


def test_it_works_again_after_what_cannot_be_compiled():
    with pytest.raises(TypingError):
        Kernel(lambda x: x.nothing, OVERLOADED)(1)
    assert gc.isenabled()
