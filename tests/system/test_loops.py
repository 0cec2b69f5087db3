"""A test that loops over cases fails for each wrong one, by name, and takes its fixtures."""

import pytest

from tests.loops import loop_over


def test_every_case_that_fails_is_named_and_the_others_run(tmp_path):
    seen = []

    @loop_over("a, b", [(1, 1), (2, 3), (4, 4), (5, 6)])
    @loop_over("kind", ["error", "fail"])
    def fails(tmp_path, a, b, kind):
        seen.append((a, kind))
        if a != b and kind == "fail":
            pytest.fail("not the same")
        assert a == b

    with pytest.raises(BaseExceptionGroup, match="2 of 4 cases failed") as found:
        fails(tmp_path=tmp_path)
    assert len(seen) == 8
    notes = [
        (note, [inner.__notes__ for inner in each.exceptions])
        for each in found.value.exceptions
        for note in each.__notes__
    ]
    by_kind = [["in the case kind='error'"], ["in the case kind='fail'"]]
    assert notes == [("in the case a=2, b=3", by_kind), ("in the case a=5, b=6", by_kind)]
    with pytest.raises(AssertionError, match="without cases"):
        loop_over("a", [])
