"""The GigE Vision device through a bare socket: protocol, control, hostile datagrams."""

import itertools
import os
import random
import socket
import struct
import time

import pytest

from sim.camera.config import CameraConfig
from sim.camera.gige import GigeDevice

DENIED, BAD_ADDRESS, BAD_PARAMETER, BAD_ALIGNMENT, UNKNOWN = 0x8006, 0x8003, 0x8002, 0x8005, 0x8001
CCP, HEARTBEAT, STREAM_PORT, STREAM_ADDRESS, PACKET_SIZE = 0x0A00, 0x0938, 0x0D00, 0x0D18, 0x0D04
_hosts = itertools.count(1)


class Client:
    def __init__(self, device):
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.connect((device.address, 3956))
        self.socket.settimeout(1.0)
        self.number = 0

    def ask(self, command, payload, number=None):
        self.number += 1
        number = number or self.number
        self.socket.send(struct.pack(">BBHHH", 0x42, 1, command, len(payload), number) + payload)
        answer = self.socket.recv(2048)
        status, acknowledge, length, answered = struct.unpack_from(">HHHH", answer)
        assert (acknowledge, length, answered) == (command + 1, len(answer) - 8, number)
        return status, answer[8:]

    def read(self, address):
        status, data = self.ask(0x80, struct.pack(">I", address))
        return int.from_bytes(data, "big") if status == 0 else -status

    def write(self, address, value, number=None):
        return self.ask(0x82, struct.pack(">II", address, value), number)[0]


@pytest.fixture
def device():
    host = f"127.{20 + os.getpid() % 200}.{1 + os.getpid() // 200 % 250}.{200 + next(_hosts)}"
    with GigeDevice(CameraConfig(width=64, height=48, serial="G"), host) as made:
        yield made


@pytest.fixture
def client(device):
    made = Client(device)
    yield made
    made.socket.close()


@pytest.fixture
def other(device):
    made = Client(device)
    yield made
    made.socket.close()


def test_discovery_answer_carries_the_names(client):
    status, data = client.ask(0x02, b"")
    assert (status, len(data)) == (0, 0xF8)
    assert data[0x48:].startswith(b"rtpiv\0")
    assert data[0xD8:].startswith(b"G\0")


def test_url_leads_to_the_description(client):
    _, data = client.ask(0x84, struct.pack(">IHH", 0x200, 0, 512))
    name, address, length = data[4:].split(b"\0")[0].decode().split(":")[1].split(";")
    assert name.endswith(".xml")
    _, first = client.ask(0x84, struct.pack(">IHH", int(address, 16), 0, 64))
    assert first[4:].startswith(b"<?xml")
    assert int(length, 16) > 1000


def test_only_the_controller_writes_and_everybody_reads(client, other):
    assert client.write(HEARTBEAT, 1000) == DENIED  # nobody is in control yet
    assert client.write(CCP, 2) == 0
    assert client.write(HEARTBEAT, 1000) == 0
    assert other.read(HEARTBEAT) == 1000
    assert other.write(CCP, 2) == DENIED
    assert client.write(CCP, 0) == 0
    assert other.write(CCP, 2) == 0


def test_a_silent_controller_loses_control(client, other):
    assert client.write(CCP, 2) == 0
    assert client.write(HEARTBEAT, 500) == 0
    time.sleep(0.3)
    assert client.read(CCP) == 2  # any word keeps it
    time.sleep(0.3)
    assert other.write(CCP, 2) == DENIED
    time.sleep(0.8)
    assert other.read(CCP) == 0
    assert other.write(CCP, 2) == 0


def test_a_repeated_write_is_answered_and_not_done_again(client, device):
    client.write(CCP, 2)
    counter = device.camera.registers.addresses["TriggerSoftware"]
    for _ in range(3):
        assert client.write(counter, 1, number=77) == 0
    assert device.camera._shutter.missed == 1  # not armed, so each real trigger counts as missed


@pytest.mark.parametrize(
    ("command", "payload", "status"),
    [
        (0x80, b"", BAD_PARAMETER),
        (0x80, b"\0\0\0", BAD_PARAMETER),
        (0x80, struct.pack(">I", 0x7FFFFFFC), BAD_ADDRESS),
        (0x84, struct.pack(">IHH", 0x201, 0, 4), BAD_ALIGNMENT),
        (0x84, struct.pack(">IHH", 0x200, 0, 0), BAD_PARAMETER),
        (0x84, struct.pack(">IHH", 0x200, 0, 0xFFFF), BAD_PARAMETER),
        (0x86, b"\0\0", BAD_PARAMETER),
        (0x82, struct.pack(">IIH", 0, 0, 0), BAD_PARAMETER),
        (0x4242, b"", UNKNOWN),
    ],
)
def test_malformed_requests_get_a_status(client, command, payload, status):
    client.write(CCP, 2)
    assert client.ask(command, payload) == (status, b"")


def test_streams_go_nowhere_but_loopback(client):
    client.write(CCP, 2)
    assert client.write(STREAM_ADDRESS, 0x08080808) == BAD_PARAMETER
    assert client.write(STREAM_ADDRESS, 0x7F000001) == 0


def test_a_device_lives_on_loopback_only():
    with pytest.raises(ValueError, match="loopback"):
        GigeDevice(CameraConfig(), "0.0.0.0")


def test_second_device_on_one_address_is_refused(device):
    with pytest.raises(OSError, match=r"[Aa]ddress"):
        GigeDevice(CameraConfig(), device.address)


def test_ten_thousand_garbage_datagrams_do_no_harm(client, device):
    rng = random.Random(5)
    client.write(CCP, 2)
    before = {name: device.camera.registers.get(name) for name in ("Width", "ExposureTime", "PixelFormat")}
    for index in range(10_000):
        if index % 2:
            data = rng.randbytes(rng.randrange(60))
        else:  # a good head with a bad rest gets further
            body = rng.randbytes(rng.randrange(40))
            command = rng.choice((0x40, 0x80, 0x82, 0x84, 0x86, 2))
            length = len(body) if rng.random() < 0.8 else rng.randrange(65536)
            # flags 0: nobody waits for ten thousand answers
            data = struct.pack(">BBHHH", 0x42, 0, command, length, 1 + index % 65535) + body
        client.socket.send(data)
        if index % 50 == 0:
            client.read(CCP)
    assert client.read(0x0000) == 0x00010002
    assert {name: device.camera.registers.get(name) for name in before} == before


def test_stream_of_one_frame_packet_by_packet(client, device):
    receiver = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    receiver.bind(("127.0.0.1", 0))
    receiver.settimeout(2.0)
    registers = device.camera.registers.addresses
    client.write(CCP, 2)
    client.write(STREAM_PORT, receiver.getsockname()[1])
    client.write(STREAM_ADDRESS, 0x7F000001)
    client.write(PACKET_SIZE, 1036)
    client.write(registers["AcquisitionMode"], 1)
    client.write(registers["AcquisitionStart"], 1)
    packets = [receiver.recv(2048)]
    while packets[-1][4] != 2:
        packets.append(receiver.recv(2048))
    heads = [struct.unpack_from(">HHI", packet) for packet in packets]
    assert [number & 0xFFFFFF for _, _, number in heads] == list(range(len(packets)))
    assert {(status, block) for status, block, _ in heads} == {(0, 1)}
    leader = struct.unpack_from(">HHIIIIIIIHH", packets[0], 8)
    assert leader[1] == 1
    assert leader[4:] == (0x01100005, 64, 48, 0, 0, 0, 0)
    pixels = b"".join(packet[8:] for packet in packets[1:-1])
    assert len(pixels) == 64 * 48 * 2
    assert {len(packet) for packet in packets[1:-2]} == {1008}
    # Any packet can be had again, and what never was cannot.
    client.socket.send(struct.pack(">BBHHHHHII", 0x42, 0, 0x40, 12, 900, 0, 1, 2, 3))
    assert receiver.recv(2048) == packets[2]
    assert receiver.recv(2048) == packets[3]
    client.socket.send(struct.pack(">BBHHHHHII", 0x42, 0, 0x40, 12, 901, 0, 44, 1, 1))
    assert receiver.recv(2048)[:4] == b"\x80\x0c\x00\x2c"
    receiver.close()
