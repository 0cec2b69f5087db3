"""Times of commands beside their record."""

from benchmarks.commands import PARTS, budget, compare


def test_commands_are_held_against_a_record_in_units_of_a_reference() -> None:
    def times(**used: float) -> dict[str, list[float]]:
        return {part: [9.0, used.get(part, 0.0)] for part in ("all", *PARTS)}

    now = budget({
        "reference": times(all=2.0), "trace": times(all=4.0, work=1.6, draw=2.0), "trace, cold": times(all=99.0),
        "check": times(all=1.0),
    })  # fmt: skip
    assert set(now) == {"trace", "check"}
    record = {"trace": {"all": 1.6, "work": 0.75, "draw": 0.6, "load": 0.0}}
    slower, new = compare(now, record)
    assert slower == "trace: 2.00 references, 1.25 of the record; grew: all 1.60 -> 2.00, draw 0.60 -> 1.00"
    assert new == "check: 0.50 references, no record"
