"""Bench files for tests: two axes on one controller of any driver."""

from sim.emulators import emulator_class
from stages.config import StagesTable
from stages.drivers import driver_class

LOW_MM, HIGH_MM = 5.0, 120.0
APPROACH = {"side": "from_below", "distance_mm": 0.3, "speed_mm_s": 1.0}


def stages_table(driver: str, **changes) -> StagesTable:
    """Two axes, a and b, with the same settings."""
    cls = driver_class(driver)
    axis = {
        "controller": "box", "carries": "target", "along": "x", "limits_mm": [LOW_MM, HIGH_MM], "speed_mm_s": 20.0,
        "acceleration_mm_s2": 100.0, "approach": APPROACH, "settle_s": 0.1,
    }  # fmt: skip
    if cls.counts_steps:
        axis["steps_per_mm"] = 400.0
    if emulator_class(driver).zero_at_top:
        axis["offset_mm"] = 130.0
    axis.update(changes)
    axes = {name: {**axis, "channel": channel} for name, channel in zip("ab", cls.example_channels, strict=True)}
    return StagesTable.model_validate(
        {"controllers": {"box": {"driver": driver, "port": "nowhere"}}, "axes": axes, "home_order": ["b", "a"]}
    )
