"""Registers by address: what a hostile client can and cannot do; the XML against the register map."""

import contextlib
import itertools
import math
import struct
import xml.etree.ElementTree as ElementTree

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.camera.features import CHUNK_ID_BASE, FEATURES, XML_BASE
from sim.camera.registers import BadAddress, BadValue, RegisterMap, WriteProtected

NAMESPACE = "{http://www.genicam.org/GenApi/Version_1_1}"


@pytest.fixture
def registers():
    made = RegisterMap("rtpiv", "SimCamera")
    made.put("WidthMax", 64)
    made.put("HeightMax", 48)
    made.put("Width", 64)
    return made


def test_every_feature_of_the_xml_leads_to_its_register(registers):
    root = ElementTree.fromstring(registers.xml)
    entries = set(root.iter(f"{NAMESPACE}EnumEntry"))  # their names are those of their enumeration alone
    named = {node.get("Name"): node for node in root.iter() if node.get("Name") and node not in entries}
    for feature in FEATURES:
        if feature.kind == "chunk":  # found by its port in the data of a frame, at no address of the device
            register = named[f"{feature.name}_Reg"]
            port = named[register.find(f"{NAMESPACE}pPort").text]
            assert int(port.find(f"{NAMESPACE}ChunkID").text, 16) >= CHUNK_ID_BASE
            continue
        node = named[feature.name] if feature.kind == "string" else named[f"{feature.name}_Reg"]
        assert int(node.find(f"{NAMESPACE}Address").text, 16) == registers.addresses[feature.name]
        assert int(node.find(f"{NAMESPACE}Length").text) == feature.length
        if feature.kind != "string":
            assert named[feature.name].find(f"{NAMESPACE}pValue").text == f"{feature.name}_Reg"
        for tag in ("pMax", "pMin"):
            limit = named[feature.name].find(f"{NAMESPACE}{tag}")
            assert limit is None or limit.text in named


def test_registers_do_not_overlap(registers):
    taken = sorted(
        (registers.addresses[f.name], registers.addresses[f.name] + f.length)
        for f in FEATURES
        if f.kind != "chunk"
    )
    assert all(end <= start for (_, end), (start, _) in itertools.pairwise(taken))


def test_writes_arrive_big_endian(registers):
    registers.write(registers.addresses["Width"], struct.pack(">I", 33))
    registers.write(registers.addresses["ExposureTime"], struct.pack(">d", 123.5))
    assert registers.integer("Width") == 33
    assert registers.number("ExposureTime") == 123.5
    assert registers.read(registers.addresses["Width"], 4) == b"\0\0\0\x21"


@pytest.mark.parametrize(
    ("name", "data", "error"),
    [
        ("Width", struct.pack(">I", 65), BadValue),
        ("Width", struct.pack(">I", 7), BadValue),
        ("Width", b"\0\0", BadAddress),
        ("ExposureTime", struct.pack(">d", math.nan), BadValue),
        ("ExposureTime", struct.pack(">d", math.inf), BadValue),
        ("ExposureTime", struct.pack(">d", -1.0), BadValue),
        ("PixelFormat", struct.pack(">I", 0x01080009), BadValue),
        ("PayloadSize", struct.pack(">I", 1), WriteProtected),
        ("DeviceVendorName", b"me\0\0", WriteProtected),
        ("DeviceUserID", b"x" * 65, BadValue),
    ],
)
def test_bad_writes_change_nothing(registers, name, data, error):
    before = registers.read(registers.addresses[name], 4)
    with pytest.raises(error):
        registers.write(registers.addresses[name], data)
    assert registers.read(registers.addresses[name], 4) == before


def test_the_xml_can_be_read_in_blocks_and_nothing_behind_it(registers):
    blocks = [registers.read(XML_BASE + at, 512) for at in range(0, len(registers.xml), 512)]
    assert b"".join(blocks).rstrip(b"\0") == registers.xml
    with pytest.raises(BadAddress):
        registers.read(XML_BASE + len(registers.xml) + 1024, 4)


@given(st.integers(-(2**40), 2**40), st.integers(-5, 2**34), st.binary(max_size=80))
def test_no_address_and_length_reaches_anything_else(address, length, data):
    registers = RegisterMap("rtpiv", "SimCamera")
    with contextlib.suppress(BadAddress):
        assert len(registers.read(address, length)) == length
    with contextlib.suppress(BadAddress, BadValue, WriteProtected):
        registers.write(address, data)
