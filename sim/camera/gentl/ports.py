"""Ports of the transport layer's own modules: small node maps that say who they are.

System, interface, device and stream each have a few read-only strings under the names of the GenTL SFNC.  The
camera itself (the remote device) has its full node map in the device model.
"""

from dataclasses import dataclass
from typing import Protocol
from xml.sax.saxutils import escape

from sim.camera.features import XML_BASE
from sim.camera.registers import BadAddress

STRING_BYTES = 256


class Port(Protocol):
    """Memory behind a GenTL port."""

    @property
    def xml(self) -> bytes:
        """GenApi description."""
        ...

    @property
    def port_name(self) -> str:
        """Name of the port in the description."""
        ...

    def read(self, address: int, length: int) -> bytes:
        """Read bytes; BadAddress outside."""
        ...

    def write(self, address: int, data: bytes) -> None:
        """Write bytes; BadAddress outside."""
        ...


@dataclass
class InfoPort:
    """Read-only strings of a transport layer module.

    Parameters
    ----------
    port_name : str
        "TLPort", "InterfacePort", "DevicePort" or "StreamPort"; also the name in the XML.
    values : dict of str to str
        Feature names with their values.
    """

    port_name: str
    values: dict[str, str]

    def __post_init__(self) -> None:
        nodes = "".join(
            f'<StringReg Name="{name}"><Address>{STRING_BYTES * index:#x}</Address>'
            f"<Length>{STRING_BYTES}</Length><AccessMode>RO</AccessMode><pPort>{self.port_name}</pPort></StringReg>\n"
            for index, name in enumerate(self.values)
        )
        features = "".join(f"<pFeature>{escape(name)}</pFeature>" for name in self.values)
        self.xml = (
            '<?xml version="1.0" encoding="utf-8"?>\n'
            '<RegisterDescription ModelName="rtpiv" VendorName="rtpiv" StandardNameSpace="None" '
            'SchemaMajorVersion="1" SchemaMinorVersion="1" SchemaSubMinorVersion="0" MajorVersion="1" '
            'MinorVersion="0" SubMinorVersion="0" ProductGuid="5b0e1f4a-6f3d-4f0b-9a86-52d1c07a4e03" '
            'VersionGuid="5b0e1f4a-6f3d-4f0b-9a86-52d1c07a4e04" '
            'xmlns="http://www.genicam.org/GenApi/Version_1_1">\n'
            f'<Category Name="Root" NameSpace="Standard">{features}</Category>\n{nodes}'
            f'<Port Name="{self.port_name}" NameSpace="Standard"></Port>\n</RegisterDescription>\n'
        ).encode()
        self._memory = b"".join(
            value.encode()[: STRING_BYTES - 1].ljust(STRING_BYTES, b"\0") for value in self.values.values()
        )

    def read(self, address: int, length: int) -> bytes:
        """Read a string's bytes or the XML; BadAddress outside, and across their ends."""
        for base, memory in ((0, self._memory), (XML_BASE, self.xml)):
            if base <= address and address + length <= base + len(memory):
                return memory[address - base : address - base + length]
        raise BadAddress(f"{length} bytes at {address:#x}")

    def write(self, address: int, data: bytes) -> None:
        """Nothing here can be written: always BadAddress."""
        raise BadAddress(f"{len(data)} bytes at {address:#x} are read-only")
