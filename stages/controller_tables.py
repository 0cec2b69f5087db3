"""What a bench file says of one controller: how it is reached. See `stages.config` for the whole.

rail:  {driver: isel_dnc, port: /dev/ttyUSB0}
glass: {driver: zaber_ascii, port: /dev/ttyUSB1, identity: serial 70001}   # words the box says of itself
"""

from typing import Annotated

from pydantic import Field

from ground.config import Table


class ControllerTable(Table):
    """A controller on a serial port."""

    driver: str
    port: Annotated[str, Field(min_length=1)]
    baud: Annotated[int, Field(ge=300, le=4_000_000)] | None = None
    identity: Annotated[str, Field(min_length=1)] | None = None

    @property
    def place(self) -> str:
        """Where it is, for messages."""
        return self.port


AnyControllerTable = ControllerTable
