"""Bench files for tests: two axes on one controller of any kind."""

from sim.emulators import emulator_class
from sim.stages import ScrewTable
from stages.config import StagesTable
from stages.drivers_by_name import driver_class

LOW_MM, HIGH_MM = 5.0, 120.0
APPROACH = {"side": "from_below", "distance_mm": 0.3, "speed_mm_s": 1.0}


BOXES = {  # kind of a library -> how a bench file names it, and two channels
    "micromanager": (
        {"driver": "micromanager", "homing": "device", "devices": {"XY": {"library": "Sim", "device": "XY"}}},
        ("XY/x", "XY/y"),
    ),
    "positioners": (
        {"driver": "positioners", "homing": "device", "objects": {n: {"object": "sim:X"} for n in "xy"}},
        ("x", "y"),
    ),
    "by_hand": ({"driver": "by_hand"}, ("upper", "lower")),
}


def stages_table(driver: str, box=None, **changes) -> StagesTable:
    """Two axes, a and b, with the same settings."""
    axis = {
        "controller": "box", "carries": "target", "along": "x", "limits_mm": [LOW_MM, HIGH_MM], "speed_mm_s": 20.0,
        "acceleration_mm_s2": 100.0, "approach": APPROACH, "settle_s": 0.1,
    }  # fmt: skip
    if driver in BOXES:
        about, channels = BOXES[driver]
    else:
        about, channels = {"driver": driver, "port": "nowhere"}, driver_class(driver).example_channels
        if driver_class(driver).counts_steps:
            axis["steps_per_mm"] = 400.0
    if emulator_class(driver).zero_at_top:
        axis["offset_mm"] = 130.0
    if driver == "by_hand":
        axis["reading_um"] = 3.0
    axis.update(changes)
    axes = {name: {**axis, "channel": channel} for name, channel in zip("ab", channels, strict=True)}
    return StagesTable.model_validate(
        {"controllers": {"box": about | (box or {})}, "axes": axes, "home_order": ["b", "a"]}
    )


def brisk(driver: str) -> dict:
    """For tests of what is said, not of how long it moves: most that is said are looks at an axis on its way."""
    speed_mm_s = 25.0 if driver == "isel_dnc" else 50.0  # 10 000 steps/s are all that this box takes
    ramp_mm_s2 = 100.0 if driver == "grbl" else 1000.0  # as this board is set
    return {"speed_mm_s": speed_mm_s, "acceleration_mm_s2": ramp_mm_s2, "approach": APPROACH | {"speed_mm_s": 3.0}}


def screws(table: StagesTable, **changes) -> dict[str, ScrewTable]:
    """What somebody built who knew the bench file: switches 5 mm outside the limits, the usual play."""
    built = {}
    for name, axis in table.axes.items():
        high = emulator_class(table.controllers[axis.controller].driver).zero_at_top
        low_mm, high_mm = sorted(axis.sign * (limit - axis.offset_mm) for limit in axis.limits_mm)
        travel_mm = 5.0 - low_mm if high else high_mm + 5.0
        about = {
            "lead_mm": 4.0, "steps_per_rev": round(4.0 * (axis.steps_per_mm or 400.0)), "travel_mm": travel_mm,
            "origin": "high switch" if high else "low switch", "power_up_mm": 0.3 * travel_mm,
            "lead_error_um": 0.0,
        }  # fmt: skip
        built[name] = ScrewTable.model_validate(about | changes)
    return built


def beside_marks(built: dict[str, ScrewTable], driver: str) -> dict[str, ScrewTable]:
    """The same, switched on beside the marks that axes are homed at: half of all looks at axes were at homing."""
    low, high = (0.49, 0.49) if driver == "pi_gcs2" else (0.05, 0.95)  # PI's mark is in the middle
    places_mm = {name: screw.travel_mm * (high if screw.zero_mm else low) for name, screw in built.items()}
    return {name: screw.model_copy(update={"power_up_mm": places_mm[name]}) for name, screw in built.items()}


def true_errors_um(bench, targets_mm):
    """True displacement from a datum minus commanded displacement, as one would measure it with a dial gauge."""
    bench.stage.move({"a": 40.0})
    datum_mm = bench.world.true_mm("a")
    errors = []
    for target_mm in targets_mm:
        bench.stage.move({"a": target_mm})
        errors.append((bench.world.true_mm("a") - datum_mm - (target_mm - 40.0)) * 1000.0)
    return errors
