"""The camera describes itself: GenApi XML made from the feature table."""

from collections.abc import Iterable, Mapping
from xml.sax.saxutils import escape

from sim.camera.features import CHUNK_BYTES, CHUNK_ID_BASE, CHUNKS, FLOAT_CHUNKS, Feature

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
        f'<{kind} Name="{name}">{_selected(feature) if kind == "StringReg" else ""}'
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


def _selected(feature: Feature) -> str:
    return "".join(f"<pSelected>{name}</pSelected>" for name in feature.selects)


def _node(feature: Feature) -> str:
    locked = "<pIsLocked>TLParamsLocked</pIsLocked>" if feature.locked else ""
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
        return f'<Enumeration Name="{feature.name}">{locked}{entries}{value}{_selected(feature)}</Enumeration>\n'
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
    features = tuple(features)
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
            parts.append(_node(feature))
        is_chunk = feature.kind == "chunk"
        parts.append(_chunk(feature) if is_chunk else _register(feature, addresses[feature.name]))
    parts.append(
        '<Integer Name="TLParamsLocked"><Visibility>Invisible</Visibility><Value>0</Value><Min>0</Min>'
        "<Max>1</Max></Integer>\n"
    )
    parts.append('<Port Name="Device" NameSpace="Standard"></Port>\n</RegisterDescription>\n')
    return "".join(parts).encode()
