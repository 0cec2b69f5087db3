"""What only the Aravis backend has: packets that get lost, a camera that is not ours, no discovery."""

import shutil
import socket
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

from daq.cameras.aravis import AravisCamera
from daq.cameras.gvcp_probe import read_register
from daq.errors import CameraLost, CameraSetupError, SettingRefused
from sim.camera.config import CameraConfig, FaultPlan
from sim.camera.gige import GigeDevice
from sim.camera.source import PatternSource
from tests.daq.cameras.rigs import loopback_address, need_aravis

SOFTWARE = {"TriggerSelector": "FrameStart", "TriggerMode": "On", "TriggerSource": "Software"}


@pytest.fixture
def device():
    need_aravis()
    made = []

    def start(**changes):
        config = CameraConfig(**({"width": 256, "height": 128, "row_time_us": 5.0} | changes))
        made.append(GigeDevice(config, loopback_address()))
        return made[-1]

    yield start
    for one in made:
        one.close()


def test_lost_packets_are_asked_for_again_and_arrive(device):
    lossy = device(faults=FaultPlan(packet_loss=0.02, seed=4))
    camera = AravisCamera(lossy.address, packet_bytes=576)
    camera.open()
    camera.configure({"PixelFormat": "Mono12p", "TriggerMode": "Off", "AcquisitionFrameRate": 40.0})
    camera.arm()
    frames = [camera.next_frame(3.0).copy() for _ in range(25)]
    counters = camera.counters
    camera.close()
    for frame in frames:
        np.testing.assert_array_equal(frame.pixels, PatternSource(256, 128).frame(int(frame.pixels[0, 0]), 0))
    # Each frame has 87 packets, so nearly every one lost some; a lost trailer nobody asks for again.
    assert counters.resent > 10
    assert lossy.resent_packets >= counters.resent
    assert frames[-1].meta.sequence + 1 == 25 + counters.losses
    assert counters.losses < 10


def test_no_camera_is_said_at_once():
    need_aravis()
    start = time.monotonic()
    with pytest.raises(CameraLost, match="no camera at"):
        AravisCamera(loopback_address()).open()
    assert time.monotonic() - start < 1.5


def test_opening_sends_nothing_to_any_other_address(device, monkeypatch):
    """libaravis would broadcast in its discovery; a second device next to ours must not hear a word."""
    one = device()
    neighbour = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    neighbour.bind((loopback_address(), 3956))
    neighbour.setblocking(False)
    everybody = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    everybody.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    everybody.bind(("255.255.255.255", 3956))
    everybody.setblocking(False)
    camera = AravisCamera(one.address)
    camera.open()
    camera.close()
    for silent in (neighbour, everybody):
        with pytest.raises(BlockingIOError):
            silent.recv(100)
        silent.close()


@pytest.mark.parametrize("answer", [b"", b"\0" * 11, b"\0" * 12, b"\xff" * 12, b"\0" * 60])
def test_a_liar_on_the_control_port_is_not_believed(answer):
    address = loopback_address()
    liar = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    liar.bind((address, 3956))
    liar.settimeout(2.0)

    def tell():
        _, asker = liar.recvfrom(100)
        liar.sendto(answer, asker)

    thread = threading.Thread(target=tell)
    thread.start()
    with pytest.raises(CameraLost, match="gave no answer"):
        read_register(address, 0x0A00, 0.3)
    thread.join()
    liar.close()


@pytest.mark.skipif(shutil.which("arv-fake-gv-camera-0.8") is None, reason="aravis-tools is not installed")
def test_the_camera_that_aravis_brings_along():
    """A device that is not ours: SFNC 1 names, ids that start at 65400 and wrap within this test."""
    need_aravis()
    address = "127.0.0.1"  # it serves addresses of interfaces only
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as place:
        try:
            place.bind((address, 3956))
        except OSError:
            pytest.skip("another camera lives on 127.0.0.1 just now")
    fake = subprocess.Popen(
        ["arv-fake-gv-camera-0.8", "-i", address, "-s", "GV77"],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        camera = _open_soon(AravisCamera(address))
        assert (camera.info.vendor, camera.info.serial) == ("Aravis", "GV77")
        camera.configure({"PixelFormat": "Mono8", "Width": 64, "Height": 48, "ExposureTime": 900.0,
                          "AcquisitionFrameRate": 200.0})  # fmt: skip
        camera.arm()
        frames = [camera.next_frame(3.0).copy() for _ in range(150)]
        counters = camera.disarm()
        camera.configure(SOFTWARE)
        camera.arm()
        for sequence in range(3):
            camera.trigger()
            assert camera.next_frame(3.0).copy().meta.sequence == sequence
        camera.close()
    finally:
        fake.terminate()
        fake.wait()
    ids = [frame.meta.frame_id for frame in frames]
    assert min(ids) < 20
    assert max(ids) > 65400
    assert 0 not in ids
    lost = counters.missing + counters.underrun + counters.incomplete  # some of them after the last one fetched
    assert 149 <= frames[-1].meta.sequence <= 149 + lost
    assert frames[0].meta.exposure_us == 900.0
    assert frames[0].pixels.shape == (48, 64)


def _open_soon(camera):
    deadline = time.monotonic() + 5
    while True:
        try:
            camera.open()
        except CameraLost:
            if time.monotonic() > deadline:
                raise
            time.sleep(0.05)
        else:
            return camera


CROWD = """
import socket, struct, sys, time
there = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
there.bind(("127.0.0.1", 0))
here = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
packet = struct.pack(">HHI", 0, 40, 3 << 24) + bytes(64)
print("talking", flush=True)
while True:
    here.sendto(packet, there.getsockname())
    time.sleep(2e-5)
"""


def test_strangers_on_the_same_interface_do_not_spoil_a_stream(device):
    """libaravis's raw socket hears everybody before its filter is set; their block ids made ours late ones."""
    camera = AravisCamera(device().address)
    camera.open()
    camera.configure({"PixelFormat": "Mono12", **SOFTWARE})
    crowd = subprocess.Popen([sys.executable, "-c", CROWD], stdout=subprocess.PIPE)
    try:
        crowd.stdout.readline()
        for _ in range(5):
            camera.arm()
            camera.trigger()
            camera.next_frame(2.0).release()
            assert camera.disarm().delivered == 1
    finally:
        crowd.kill()
        crowd.communicate()
        camera.close()


@pytest.fixture
def fake():
    """The camera that libaravis has in this process, opened as one on USB is."""
    need_aravis()
    camera = AravisCamera(device_id="Fake_1")
    camera.open()
    yield camera
    camera.close()


def test_a_camera_by_its_id_is_set_up_and_sends_frames(fake):
    assert (fake.info.vendor, fake.info.address) == ("Aravis", "device Fake_1")
    back = fake.configure({"Width": 96, "Height": 32, "PixelFormat": "Mono8", "AcquisitionFrameRate": 100.0})
    assert back["Width"] == 96
    fake.arm(8)
    sequence, ids = [], []
    for _ in range(150):  # its ids begin shortly before 65535, which is followed by 1
        with fake.next_frame(3.0) as frame:
            sequence.append(frame.meta.sequence)
            ids.append(frame.meta.frame_id)
            assert frame.pixels.shape == (32, 96)
            steps = np.diff(frame.pixels[0].astype(int))
            assert set(steps) <= {1, -254, -255}  # its ramp
    assert max(ids) == 65535
    assert min(ids) < 10
    assert sequence == sorted(sequence)
    fake.verify()
    fake.probe(0.5)
    counts = fake.disarm()
    assert (counts.incomplete, counts.resent, counts.delivered) == (0, 0, 150)
    assert counts.missing <= counts.underrun + sequence[-1] - 149
    with pytest.raises(SettingRefused):
        fake.configure({"PixelFormat": "BayerRG8p"})


def test_an_id_that_nobody_has_and_two_names_for_one_camera_are_refused(fake):
    with pytest.raises(CameraLost, match=r"Nobody-1.* plugged in"):
        AravisCamera(device_id="Nobody-1").open()
    for options in ({}, {"address": "127.0.0.1", "device_id": "Fake_1"}):
        with pytest.raises(CameraSetupError, match=r"`address`.*`device_id`"):
            AravisCamera(**options)
