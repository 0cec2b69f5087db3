"""The ``stages:`` part of a bench file.

    stages:
      controllers:
        rail: {driver: isel_dnc, port: /dev/ttyUSB0}   # other ways: stages.controller_tables
        glass: {driver: zaber_ascii, port: /dev/ttyUSB1, identity: serial 70001}   # words the box says of itself
      axes:
        rail_z:
          controller: rail
          channel: X                   # the controller's own name of the motor
          carries: camera              # element of the scene that moves with it
          along: z                     # world direction of growing position
          steps_per_mm: 320.0          # for controllers that count steps
          sign: 1                      # -1 if the motor runs the other way
          offset_mm: 0.0               # axis = sign * controller + offset
          limits_mm: [0.0, 1900.0]     # mandatory, never clipped
          speed_mm_s: 30.0
          acceleration_mm_s2: 100.0
          approach: {side: from_below, distance_mm: 0.5, speed_mm_s: 2.0}
          settle_s: 0.3
          in_position_um: 10.0         # at most 10; of an axis that is moved by hand 500
          reading_um: 5.0              # only and always of an axis that is moved by hand: sigma of a reading
          retries: 2
          homed_at_mm: 1.0             # optional: where homing leaves it, to judge the way out before it moves
      home_order: [rail_z, glass_y]    # every axis once; homing happens on request only
      move_order: [glass_y, rail_z]    # optional: order of the legs of a move of several axes
      after_home: [{glass_y: -20.0}]   # optional: the way out of the homed place, one move after the other

A controller with an `identity` is used only if what answers at every connect says these words of itself: two boxes
on swapped cables are refused before anything moves. `after_home` is carried out whenever all axes have been homed;
its moves are judged as every move, so what stands too close already may move away and not come closer.

Embed `StagesTable` in the table of a larger file; `validate` of `ground.config` then reports every problem with
its line.
"""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from ground.config import Name, Table
from stages.axis_settings import AxisSettings
from stages.controller_tables import AnyControllerTable, ForeignTable, HandTable
from stages.drivers_by_name import check_driver
from stages.errors import StageUsageError


class AxisTable(AxisSettings):
    """An axis; see the module's text."""

    controller: Name
    carries: Name
    along: Literal["x", "y", "z"]
    homed_at_mm: float | None = None


def port_conflicts(ports: Mapping[str, str]) -> list[str]:
    """Name the devices that are given one port, a sentence for each port; "" is no port."""
    users: dict[str, list[str]] = {}
    for name, port in ports.items():
        if port:
            users.setdefault(port if "://" in port else os.path.realpath(port), []).append(name)
    return [
        f"{' and '.join(names)} have the same port {ports[names[0]]}; give each box its own (devices on one line, "
        "as a chain of Zaber or PI devices, are one controller with several channels)"
        for names in users.values()
        if len(names) > 1
    ]


class StagesTable(Table):
    """All controllers and axes of a bench."""

    controllers: dict[Name, AnyControllerTable]
    axes: dict[Name, AxisTable]
    home_order: list[Name]
    move_order: list[Name] | None = None
    after_home: list[Annotated[dict[Name, float], Field(min_length=1)]] = Field(default_factory=list)

    @model_validator(mode="after")
    def _fits_together(self) -> "StagesTable":
        problems = []
        hands = {name for name, controller in self.controllers.items() if isinstance(controller, HandTable)}
        motors = [(axis.controller, str(axis.channel)) for axis in self.axes.values()]
        for name, axis in self.axes.items():
            if axis.controller not in self.controllers:
                problems.append(f"axis {name} names an unknown controller {axis.controller!r}")
            if motors.count((axis.controller, str(axis.channel))) > 1:
                problems.append(f"axis {name} shares its channel with another axis")
            if axis.controller in hands and axis.reading_um is None:
                problems.append(
                    f"axis {name} is moved by hand; say reading_um, the standard deviation of a reading"
                )
            elif axis.controller not in hands and axis.reading_um is not None:
                problems.append(f"axis {name} has a motor; reading_um is said of axes that are moved by hand")
            if axis.controller in hands and axis.steps_per_mm is not None:
                problems.append(f"axis {name} is moved by hand, which counts no steps; remove steps_per_mm")
        for key, order in (("home_order", self.home_order), ("move_order", self.move_order)):
            if order is not None and sorted(order) != sorted(self.axes):
                problems.append(f"{key} must name every axis once")
        for move in self.after_home:
            for name, mm in move.items():
                if name not in self.axes:
                    problems.append(f"after_home names an unknown axis {name!r}")
                elif not self.axes[name].limits_mm[0] <= mm <= self.axes[name].limits_mm[1]:
                    problems.append(f"after_home: {name} {mm:g} mm is outside its limits")
        for name, controller in self.controllers.items():
            try:
                check_driver(controller.driver)
            except StageUsageError as error:
                problems.append(f"controller {name}: {error}")
            channels = {str(axis.channel) for axis in self.axes.values() if axis.controller == name}
            if isinstance(controller, ForeignTable) and (text := controller.problem(channels)):
                problems.append(f"controller {name}: {text}")
        if problems:
            raise ValueError("; ".join(problems))
        return self

    @property
    def by_hand(self) -> dict[str, float]:
        """Axes that a person moves, and the standard deviation of a reading of their scales [um]."""
        return {name: axis.reading_um for name, axis in self.axes.items() if axis.reading_um is not None}

    def require_own_ports(self) -> None:
        """StageUsageError if two controllers have one port, as the system names it now."""
        ports = {name: str(getattr(table, "port", "")) for name, table in self.controllers.items()}
        if problems := port_conflicts(ports):
            raise StageUsageError("; ".join(problems))

    def beside(self, folder: Path) -> "StagesTable":
        """Return the same with files of controllers found in the folder of the bench file."""
        found = {
            name: table.beside(folder) if isinstance(table, ForeignTable) else table
            for name, table in self.controllers.items()
        }
        return self.model_copy(update={"controllers": found})
