"""Reading a camera's clock by its new and its old names."""

import pytest

from daq.cameras.ids import CameraClock


class Features:
    """Features by name; a command latches the time into the value of its name."""

    def __init__(self, now, **values):
        self.now, self.values = now, values

    def has(self, name):
        return name in self.values

    def get(self, name):
        return self.values[name]

    def can_execute(self, name):
        return self.has(name)

    def execute(self, name):
        target = {"TimestampLatch": "TimestampLatchValue", "GevTimestampControlLatch": "GevTimestampValue"}[name]
        self.values[target] = self.now


NEW = {"TimestampLatch": None, "TimestampLatchValue": 0}
OLD = {"GevTimestampControlLatch": None, "GevTimestampValue": 0}


@pytest.mark.parametrize(
    ("values", "read_ns"),
    [
        (NEW, 1234),
        (OLD | {"GevTimestampTickFrequency": 125_000_000}, 1234 * 8),
        (OLD | {"GevTimestampTickFrequency": 1_000_000_000}, 1234),
        (NEW | OLD | {"GevTimestampTickFrequency": 125_000_000}, 1234),
        (OLD | {"GevTimestampTickFrequency": 0}, None),  # GigE Vision: the camera has no clock
        (OLD, None),
        ({"TimestampLatchValue": 7}, None),
        ({}, None),
    ],
)
def test_the_clock_is_read_in_nanoseconds_or_not_at_all(values, read_ns):
    features = Features(1234, **values)
    assert CameraClock(features).read_ns(features) == read_ns
