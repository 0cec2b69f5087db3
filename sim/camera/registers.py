"""The camera's memory and its description: typed registers over bytes, and GenApi XML made from the feature table.

Addresses and lengths come from a client and are not trusted: anything outside a register is refused, a write must
hit one register exactly, and its value must lie within the feature's limits.
"""

import math
import struct
from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from dataclasses import replace
from xml.sax.saxutils import escape

from sim.camera.features import (
    CHUNK_BYTES,
    CHUNK_ID_BASE,
    CHUNKS,
    FEATURE_BASE,
    FEATURES,
    FLOAT_CHUNKS,
    XML_BASE,
    Conditions,
    Feature,
)

BOOTSTRAP_BYTES = 0x1000
Value = int | float | str


class BadAddress(Exception):  # noqa: N818 - named after GenTL's and GigE Vision's status
    """No register at this address, or of this length."""


class BadValue(Exception):  # noqa: N818
    """The register cannot take this value."""


class WriteProtected(Exception):  # noqa: N818
    """The register is read-only, or locked while the stream runs."""


class RegisterMap:
    """Registers of one camera.

    Parameters
    ----------
    vendor, model : str
        Names for the XML description.
    without : collection of str
        Features that this camera does not have.
    features : sequence of Feature
        The table.
    """

    def __init__(
        self, vendor: str, model: str, without: Container[str] = (), features: Sequence[Feature] = FEATURES
    ) -> None:
        features = tuple(feature for feature in features if feature.name not in without)
        self._features = {feature.name: feature for feature in features}
        self.addresses = _lay_out(tuple(feature for feature in features if feature.kind != "chunk"))
        self._at = {address: self._features[name] for name, address in self.addresses.items()}
        top = max(address + self._at[address].length for address in self._at)
        self.bootstrap = bytearray(BOOTSTRAP_BYTES)
        self._memory = bytearray(top - FEATURE_BASE)
        self.xml = describe(features, self.addresses, vendor, model)
        # of features with a value per entry of their selector
        self._elsewhere: dict[tuple[str, int], Value] = {}
        self.on_write: Callable[[str, Value], None] | None = None
        self.before_read: Callable[[str], None] | None = None
        self.reset()

    def reset(self) -> None:
        """Give every feature its value after power-up."""
        for name in self.addresses:
            self.put(name, self._features[name].default)
        self._elsewhere.clear()

    def has(self, name: str) -> bool:
        """Return whether this camera has a feature."""
        return name in self._features

    def at(self, address: int) -> Feature | None:
        """Feature whose register begins at an address."""
        return self._at.get(address)

    def selection(self) -> dict[str, str]:
        """Entries of all selectors now."""
        return {name: self.entry(name) for name, feature in self._features.items() if feature.selects}

    def feature(self, name: str) -> Feature:
        """A feature's row in the table; KeyError if this camera has none of that name."""
        return self._features[name]

    def decode(self, name: str, data: bytes) -> Value:
        """Value in the bytes of a feature's register; an enumeration's is its number."""
        return _decode(self._features[name], data)

    def encode(self, name: str, value: Value) -> bytes:
        """Bytes of a feature's register for a value."""
        return _encode(self._features[name], value)

    def get(self, name: str) -> Value:
        """Value of a feature; an enumeration's value is its number."""
        feature = self._features[name]
        raw = self._bytes(self.addresses[name], feature.length)
        return _decode(feature, raw)

    def integer(self, name: str) -> int:
        """Value of an integer, boolean or enumeration."""
        return int(self.get(name))

    def number(self, name: str) -> float:
        """Value of a float."""
        return float(self.get(name))

    def entry(self, name: str) -> str:
        """Entry's name of an enumeration."""
        value = self.get(name)
        return next(entry for entry, number in self._features[name].entries if number == value)

    def put(self, name: str, value: Value) -> None:
        """Set a feature from inside the camera; limits and access rights do not apply."""
        feature = self._features[name]
        if feature.selects and name in self.addresses:
            self._exchange([self._features[one] for one in feature.selects if one in self.addresses], name, value)
        self._store(self.addresses[name], _encode(feature, value))

    def read(self, address: int, length: int) -> bytes:
        """Read `length` bytes at `address` as a client does; BadAddress outside all registers."""
        if length < 0 or length > 1 << 24 or address < 0:
            raise BadAddress(f"{length} bytes at {address:#x}")
        if self.before_read is not None and address in self._at:
            self.before_read(self._at[address].name)
        return self._bytes(address, length)

    def write(self, address: int, data: bytes) -> None:
        """Write one register as a client does.

        Raises
        ------
        BadAddress, WriteProtected, BadValue
            And nothing has changed.
        """
        feature = self._at.get(address)
        if feature is None or (len(data) != feature.length and feature.kind != "string"):
            raise BadAddress(f"no register of {len(data)} bytes at {address:#x}")
        if feature.access == "RO":
            raise WriteProtected(feature.name)
        if len(data) > feature.length:
            raise BadValue(f"{feature.name}: {len(data)} bytes do not fit")
        if not self.holds(feature.exists_while) or not self.holds(feature.writable_while):
            raise WriteProtected(f"{feature.name} in the present state")
        value = _decode(feature, data)
        self._check(feature, value)
        if self.on_write is not None:
            self.on_write(feature.name, value)
        else:
            self.put(feature.name, value)

    def holds(self, conditions: Conditions) -> bool:
        """Return whether every feature has one of the entries or numbers asked for."""
        return all(self.integer(name) in _numbers(self._features[name], values) for name, values in conditions)

    def _exchange(self, selected: Sequence[Feature], selector: str, value: Value) -> None:
        """Put values of the entry that is left aside, and take those of the new one out."""
        before = self.integer(selector)
        for feature in selected if before != value else ():
            if feature.is_per_entry:
                self._elsewhere[feature.name, before] = self.get(feature.name)
                self.put(feature.name, self._elsewhere.pop((feature.name, int(value)), feature.default))

    def _check(self, feature: Feature, value: Value) -> None:
        if feature.kind in ("string", "command"):
            return
        if feature.entries and value not in dict(feature.entries).values():
            raise BadValue(f"{feature.name} has no entry {value}")
        if feature.entries:
            return
        low = self.number(feature.low) if isinstance(feature.low, str) else feature.low
        high = self.number(feature.high) if isinstance(feature.high, str) else feature.high
        if not (isinstance(value, int | float) and math.isfinite(value) and low <= value <= high):
            raise BadValue(f"{feature.name} = {value} is outside {low} to {high}")

    def _bytes(self, address: int, length: int) -> bytes:
        for base, memory in ((0, self.bootstrap), (FEATURE_BASE, self._memory), (XML_BASE, self.xml)):
            offset = address - base
            room = len(memory) - offset
            if offset < 0 or room <= 0:
                continue
            if length <= room:
                return bytes(memory[offset : offset + length])
            if base == XML_BASE and length <= room + 600:  # clients round the last block up
                return bytes(memory[offset:]).ljust(length, b"\0")
        raise BadAddress(f"{length} bytes at {address:#x}")

    def _store(self, address: int, data: bytes) -> None:
        memory, base = (self.bootstrap, 0) if address < BOOTSTRAP_BYTES else (self._memory, FEATURE_BASE)
        memory[address - base : address - base + len(data)] = data


def _lay_out(features: tuple[Feature, ...]) -> dict[str, int]:
    addresses = {}
    free = FEATURE_BASE
    for feature in features:
        if feature.address:
            addresses[feature.name] = feature.address
            continue
        addresses[feature.name] = free
        free += -(-feature.length // 16) * 16
    return addresses


def _decode(feature: Feature, data: bytes) -> Value:
    if feature.kind == "string":
        return data.split(b"\0", 1)[0].decode("utf-8", "replace")
    if feature.kind == "float":
        return float(struct.unpack(">d", data)[0])
    number = int.from_bytes(data, "big")
    return number & 0xFFFF if feature.name == "GevSCPSPacketSize" else number  # the upper half holds flags


def _encode(feature: Feature, value: Value) -> bytes:
    if feature.kind == "string":
        return str(value).encode()[: feature.length - 1].ljust(feature.length, b"\0")
    if feature.kind == "float":
        return struct.pack(">d", float(value))
    return int(value).to_bytes(feature.length, "big")


_HEADER = (
    '<?xml version="1.0" encoding="utf-8"?>\n'
    '<RegisterDescription ModelName="{model}" VendorName="{vendor}" ToolTip="Simulated PIV camera" '
    'StandardNameSpace="None" SchemaMajorVersion="1" SchemaMinorVersion="1" SchemaSubMinorVersion="0" '
    'MajorVersion="1" MinorVersion="0" SubMinorVersion="0" '
    'ProductGuid="5b0e1f4a-6f3d-4f0b-9a86-52d1c07a4e01" VersionGuid="5b0e1f4a-6f3d-4f0b-9a86-52d1c07a4e02" '
    'xmlns="http://www.genicam.org/GenApi/Version_1_1" '
    'xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" '
    'xsi:schemaLocation="http://www.genicam.org/GenApi/Version_1_1 '
    'http://www.genicam.org/GenApi/GenApiSchema_Version_1_1.xsd">\n'
)


def _limit(tag: str, limit: float | str) -> str:
    if isinstance(limit, str):
        return f"<p{tag}>{limit}</p{tag}>"
    return f"<{tag}>{limit!r}</{tag}>"


def _register(feature: Feature, address: int) -> str:
    kinds = {"float": "FloatReg", "string": "StringReg"}
    kind = kinds.get(feature.kind, "IntReg")
    name = feature.name if kind == "StringReg" else f"{feature.name}_Reg"
    access = "WO" if feature.kind == "command" else feature.access
    sign = "<Sign>Unsigned</Sign>" if kind == "IntReg" else ""
    endian = "" if kind == "StringReg" else "<Endianess>BigEndian</Endianess>"
    return (
        f'<{kind} Name="{name}">{_selection_xml(feature) if kind == "StringReg" else ""}'
        f"<Address>{address:#x}</Address><Length>{feature.length}</Length><AccessMode>{access}</AccessMode>"
        f"<pPort>Device</pPort><Cachable>NoCache</Cachable>{sign}{endian}</{kind}>\n"
    )


def _chunk(feature: Feature) -> str:
    """Register within the data that came with the last frame, and the port that finds it by its id."""
    name = feature.name.removeprefix("Chunk")
    number, is_float = CHUNK_ID_BASE + CHUNKS.index(name), name in FLOAT_CHUNKS
    kind, sign = ("FloatReg", "") if is_float else ("IntReg", "<Sign>Unsigned</Sign>")
    return (
        f'<{kind} Name="{feature.name}_Reg"><Address>0x0</Address><Length>{CHUNK_BYTES}</Length>'
        f"<AccessMode>RO</AccessMode><pPort>{feature.name}_Port</pPort><Cachable>NoCache</Cachable>"
        f"{sign}<Endianess>BigEndian</Endianess></{kind}>\n"
        f'<Port Name="{feature.name}_Port"><ChunkID>{number:08X}</ChunkID></Port>\n'
    )


def _selection_xml(feature: Feature) -> str:
    return "".join(f"<pSelected>{name}</pSelected>" for name in feature.selects)


def _node(feature: Feature, table: Mapping[str, Feature]) -> str:
    locked = f"<pIsAvailable>{feature.name}_Avl</pIsAvailable>" if feature.exists_while else ""
    if feature.writable_while:
        locked += f"<pIsLocked>{feature.name}_Lck</pIsLocked>"
    elif feature.locked:
        locked += "<pIsLocked>TLParamsLocked</pIsLocked>"
    conditions = ""
    if feature.exists_while:
        conditions += _condition(f"{feature.name}_Avl", feature.exists_while, table, "?1:0")
    if feature.writable_while:
        conditions += _condition(f"{feature.name}_Lck", feature.writable_while, table, "?0:1")
    return conditions + _own_node(feature, locked)


def _numbers(feature: Feature, values: Sequence[str | int]) -> list[int]:
    """Numbers in a feature's register for entries or numbers."""
    return [int(dict(feature.entries).get(str(value), value)) for value in values]


def _condition(name: str, conditions: Conditions, table: Mapping[str, Feature], answer: str) -> str:
    """Node that is 1 or 0 by the values of other features."""
    terms = []
    for number, (other, values) in enumerate(conditions):
        terms.append("||".join(f"(V{number}={value})" for value in _numbers(table[other], values)))
    variables = "".join(
        f'<pVariable Name="V{number}">{other}_Reg</pVariable>' for number, (other, _) in enumerate(conditions)
    )
    terms = [f"({term})" for term in terms]
    formula = escape(f"({'&&'.join(terms)}){answer}")
    return f'<IntSwissKnife Name="{name}">{variables}<Formula>{formula}</Formula></IntSwissKnife>\n'


def _own_node(feature: Feature, locked: str) -> str:
    value = f"<pValue>{feature.name}_Reg</pValue>"
    if feature.kind == "command":
        return f'<Command Name="{feature.name}">{value}<CommandValue>1</CommandValue></Command>\n'
    if feature.kind == "bool":
        return (
            f'<Boolean Name="{feature.name}">{locked}{value}<OnValue>1</OnValue><OffValue>0</OffValue></Boolean>\n'
        )
    if feature.kind == "enum":
        entries = "".join(
            f'<EnumEntry Name="{entry}"><Value>{number}</Value></EnumEntry>' for entry, number in feature.entries
        )
        return (
            f'<Enumeration Name="{feature.name}">{locked}{entries}{value}{_selection_xml(feature)}</Enumeration>\n'
        )
    if feature.kind == "chunk":
        kind = "Float" if feature.name.removeprefix("Chunk") in FLOAT_CHUNKS else "Integer"
        return f'<{kind} Name="{feature.name}">{value}</{kind}>\n'
    limits = _limit("Min", feature.low) + _limit("Max", feature.high)
    if feature.kind == "float":
        unit = f"<Unit>{escape(feature.unit)}</Unit>" if feature.unit else ""
        return f'<Float Name="{feature.name}">{locked}{value}{limits}{unit}</Float>\n'
    increment = "" if feature.access == "RO" else "<Inc>1</Inc>"
    return f'<Integer Name="{feature.name}">{locked}{value}{limits}{increment}</Integer>\n'


def describe(features: Iterable[Feature], addresses: Mapping[str, int], vendor: str, model: str) -> bytes:
    """Return the XML description of a device.

    Parameters
    ----------
    features : iterable of Feature
        The table.
    addresses : mapping of str to int
        Register address of each feature.
    vendor, model : str
        Names in the head of the description; letters, digits and underscores.
    """
    features, addresses = _as_shown(tuple(features), addresses)
    table = {feature.name: feature for feature in features}
    categories: dict[str, list[str]] = {}
    for feature in features:
        categories.setdefault(feature.category, []).append(feature.name)
    categories.setdefault("TransportLayerControl", []).append("TLParamsLocked")
    parts = [_HEADER.format(model=escape(model), vendor=escape(vendor))]
    roots = "".join(f"<pFeature>{category}</pFeature>" for category in categories)
    parts.append(f'<Category Name="Root" NameSpace="Standard">{roots}</Category>\n')
    for category, names in categories.items():
        inner = "".join(f"<pFeature>{name}</pFeature>" for name in names)
        parts.append(f'<Category Name="{category}" NameSpace="Standard">{inner}</Category>\n')
    for feature in features:
        if feature.kind != "string":
            parts.append(_node(feature, table))
        is_chunk = feature.kind == "chunk"
        parts.append(_chunk(feature) if is_chunk else _register(feature, addresses[feature.name]))
    parts.append(
        '<Integer Name="TLParamsLocked"><Visibility>Invisible</Visibility><Value>0</Value><Min>0</Min>'
        "<Max>1</Max></Integer>\n"
    )
    parts.append('<Port Name="Device" NameSpace="Standard"></Port>\n</RegisterDescription>\n')
    return "".join(parts).encode()


def _as_shown(
    features: Sequence[Feature], addresses: Mapping[str, int]
) -> tuple[tuple[Feature, ...], dict[str, int]]:
    """The table with the names that the description has, and without what it does not show."""
    names = {feature.name: feature.shown or feature.name for feature in features if feature.shown is not None}

    def rename(conditions: Conditions) -> Conditions:
        return tuple((names[name], values) for name, values in conditions)

    shown = tuple(
        replace(
            feature,
            name=names[feature.name],
            selects=tuple(names[name] for name in feature.selects if name in names),
            exists_while=rename(feature.exists_while),
            writable_while=rename(feature.writable_while),
        )
        for feature in features
        if feature.name in names
    )
    return shown, {names[name]: address for name, address in addresses.items() if name in names}
