"""`rtpiv doctor`: what is there, what it lacks, and lines that a bench file takes as they are."""

import grp
import os
import socket
import stat
from types import SimpleNamespace

import pytest
import yaml

from daq.bench import surroundings
from daq.errors import BenchLacks
from rtpiv.command_line.cli import DONE, USAGE, main
from rtpiv.verbs.doctor import bench_lines, doctor
from stages.drivers_by_name import DRIVERS
from tests.daq.small_bench import write_bench
from tests.loops import loop_over

EVIL = 'a"b\\c: {\x1b]0;x\x07#'


def plug(device, **says):
    """A port as pyserial lists it."""
    nothing = dict.fromkeys(("vid", "pid", "serial_number", "manufacturer", "product"))
    return SimpleNamespace(**nothing | {"device": str(device), "description": "n/a"} | says)


def connected():
    """Serial ports, cameras and producers of the computer, and the lines of a bench file that open them."""
    found = surroundings.serial_ports(), surroundings.usb_cameras(), surroundings.producers()
    return *found, yaml.safe_load(bench_lines(*found))


@pytest.fixture
def surrounded(tmp_path, monkeypatch):
    """A computer with these plugs and this tree of USB; opening or sending anything is an error."""

    def forbidden(*_, **__):
        raise AssertionError("something was opened or sent")

    def make(plugs=(), usb=(), cti=()):
        monkeypatch.setattr(surroundings.list_ports, "comports", lambda: sorted(plugs, key=lambda p: p.device))
        monkeypatch.setattr(surroundings, "BY_ID", tmp_path / "by-id")
        for number, (kind, says) in enumerate(usb, 1):
            device = tmp_path / "usb" / f"1-{number}"
            interface = tmp_path / "usb" / f"1-{number}:1.0"
            for folder, texts in ((device, says), (interface, dict(zip(INTERFACE, kind, strict=True)))):
                folder.mkdir(parents=True)
                for name, text in texts.items():
                    (folder / name).write_text(f"{text}\n", encoding="utf-8")
        monkeypatch.setattr(surroundings.usb_cameras, "__defaults__", (tmp_path / "usb",))
        monkeypatch.setattr(surroundings.producers, "__defaults__", (tmp_path / "opt",))
        for name in cti:
            (tmp_path / "gentl").mkdir(exist_ok=True)
            (tmp_path / "gentl" / name).touch()
        monkeypatch.setenv(surroundings.GENTL_PATH, f"/nowhere{os.pathsep}{tmp_path / 'gentl'}")
        for name in ("serial.serial_for_url", "serial.Serial.open"):
            monkeypatch.setattr(name, forbidden)
        monkeypatch.setattr(socket, "socket", forbidden)

    return make


INTERFACE = ("bInterfaceClass", "bInterfaceSubClass", "bInterfaceProtocol")
CAMERA = {"manufacturer": "Maker", "product": "U3-1", "serial": "0042", "busnum": 1, "devnum": 7}
THORLABS = {"vid": 0x0403, "pid": 0xFAF0, "manufacturer": "Thorlabs", "product": "APT DC Motor Controller"}


def test_what_is_plugged_in_is_found_and_its_lines_are_taken(surrounded, tmp_path, capsys):
    (tmp_path / "by-id").mkdir()
    ports = [tmp_path / name for name in ("ttyUSB0", "ttyUSB1")]
    for port in ports:
        port.touch()
    (tmp_path / "by-id" / "usb-Thorlabs_27000001").symlink_to(ports[0])
    surrounded(
        plugs=[plug(ports[0], serial_number="27000001", **THORLABS), plug(ports[1], vid=0x0403, pid=0x6001)],
        usb=[(("ef", "05", "00"), CAMERA), (("ef", "05", "01"), CAMERA), (("08", "06", "50"), CAMERA)],
        cti=["vendor.cti"],
    )
    assert main(["doctor"]) == DONE
    said = capsys.readouterr().out
    for words in ("27000001", "0403:faf0", "Maker U3-1", "vendor.cti", "discovery is a broadcast", "thorlabs_apt"):
        assert words in said
    _, cameras, _, lines = connected()
    assert [camera.serial for camera in cameras] == ["0042"]
    boxes = lines["stages"]["controllers"]
    assert boxes["thorlabs_apt_1"] == {
        "driver": "thorlabs_apt",
        "port": str(tmp_path / "by-id" / "usb-Thorlabs_27000001"),
    }
    assert boxes["box_2"]["port"] == str(ports[1])
    options = {"cti": str(tmp_path / "gentl" / "vendor.cti"), "serial": "0042"}
    assert lines["camera"] == {"backend": "harvesters", "options": options}


@loop_over(
    "says, driver",
    [
        ({"vid": 0x0403, "pid": 0xFAF0}, "thorlabs_apt"),
        ({"product": "Kinesis by THORLABS"}, "thorlabs_apt"),
        ({"vid": 0x1A72, "pid": 0x1007}, "pi_gcs2"),
        ({"manufacturer": "Zaber Technologies"}, "zaber_ascii"),
        ({"vid": 0x0403, "pid": 0x6001, "product": "FT232R USB UART"}, None),
        ({}, None),
    ],
)
def test_a_plug_that_tells_its_maker_gets_its_driver_and_no_other(surrounded, says, driver):
    surrounded(plugs=[plug("/dev/ttyUSB0", **says)])
    assert [port.driver for port in connected()[0]] == [driver]


def test_who_pastes_a_driver_that_nobody_chose_is_told_which_there_are(surrounded, tmp_path, capsys):
    surrounded(plugs=[plug("/dev/ttyS0")])
    pasted = connected()[-1]["stages"]["controllers"]["box_1"]["driver"]
    path = write_bench(tmp_path)
    path.write_text(path.read_text().replace("driver: isel_dnc", f"driver: {pasted}"))
    assert main(["check", str(path)]) == USAGE
    said = capsys.readouterr().err
    assert all(name in said for name in DRIVERS)


def test_a_producer_that_this_shell_was_not_told_of_is_found_and_each_once(surrounded, tmp_path, monkeypatch):
    surrounded()
    for place in ("Maker/lib/gentl/a.cti", "b.cti", "far/1/2/3/4/too_far.cti"):
        (tmp_path / "opt" / place).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "opt" / place).touch()
    monkeypatch.setenv(surroundings.GENTL_PATH, str(tmp_path / "opt" / "Maker/lib/gentl"))
    assert [path.name for path in connected()[2]] == ["a.cti", "b.cti"]


def test_a_camera_on_usb_is_not_offered_by_an_address(surrounded):
    surrounded(usb=[(("ef", "05", "00"), CAMERA)])
    camera = connected()[-1]["camera"]
    assert (camera["backend"], camera["options"]["serial"]) == ("harvesters", "0042")


def test_nothing_plugged_in_still_shows_how(surrounded):
    surrounded()
    lines = connected()[-1]
    assert lines["stages"]["controllers"]["box_1"]["port"].startswith("/dev/serial/by-id")
    assert lines["camera"] == {"backend": "aravis", "options": {"address": "192.168.10.8"}}


def test_what_a_plug_says_of_itself_cannot_write_into_the_file(surrounded, capsys):
    surrounded(plugs=[plug(f"/dev/{EVIL}", product=EVIL)], usb=[(("ef", "05", "00"), CAMERA | {"serial": EVIL})])
    doctor()
    assert connected()[-1]["stages"]["controllers"]["box_1"]["port"] == f"/dev/{EVIL}"
    assert "\x1b" not in capsys.readouterr().out


@pytest.mark.posix("ports that are files")
@pytest.mark.parametrize(
    ("makes", "group", "words"),
    [
        ("nothing", "", "there is no"),
        ("dangling", "", "leads to nothing"),
        ("closed", "", "a udev rule"),
        ("other group", "", "sudo usermod -aG lab $USER, then log out and in again"),
        ("other group", "joined", "has joined since; log out and in again"),
        ("own group", "", "something else forbids it"),
        ("open", "", None),
    ],
)
def test_why_a_port_cannot_be_opened(tmp_path, monkeypatch, makes, group, words):
    path = tmp_path / "ttyUSB0"
    if makes == "dangling":
        path.symlink_to(tmp_path / "gone")
    elif makes != "nothing":
        path.touch()
        path.chmod(0o600 if makes == "closed" else 0o660)
        monkeypatch.setattr(os, "access", lambda *_: makes == "open")  # root may open anything
    monkeypatch.setattr(os, "getgroups", lambda: [path.stat().st_gid] if makes == "own group" else [])
    monkeypatch.setattr(grp, "getgrgid", lambda number: SimpleNamespace(gr_name="lab"))
    import pwd

    me = pwd.getpwuid(os.getuid()).pw_name
    monkeypatch.setattr(grp, "getgrnam", lambda name: SimpleNamespace(gr_mem=[me] if group else []))
    why = surroundings.why_not(path)
    assert why is None if words is None else words in why
    if path.exists():
        assert stat.S_ISREG(path.stat().st_mode)


@pytest.mark.posix("ports that are files")
def test_the_doctor_tells_per_device_what_it_lacks(surrounded, tmp_path, monkeypatch):
    surrounded()
    path = write_bench(tmp_path)
    text = path.read_text()
    second = "  second: {kind: camera, backend: harvesters, options: {cti: /opt/gone.cti}}\n"
    second += "  third: {kind: camera, backend: micromanager, options: {adapters: /opt/gone, core: mine:Core}}\n"
    path.write_text(f"{text}devices:\n{second}" if "devices:" not in text else text)
    monkeypatch.setattr(surroundings, "find_spec", lambda name: None)
    monkeypatch.setenv("RTPIV_TRUST", "mine:Core")
    with pytest.raises(BenchLacks, match="camera second") as lacks:
        doctor(path)
    found = {what: (fine, words) for what, fine, words in lacks.value.findings}
    assert found["controller rail"] == (
        False,
        "there is no /dev/ttyUSB0; is it plugged in and switched on? rtpiv doctor lists what is",
    )
    assert found["camera second"][0] is False
    assert "rtpiv[camera]" in found["camera second"][1]
    assert found["camera second's producer"][0] is False
    assert "/opt/gone.cti" in found["camera second's producer"][1]
    assert found["camera third"] == (True, "by micromanager")  # a core of somebody's own
    assert found["camera third's adapters"] == (False, "there is no folder /opt/gone")


def test_a_backend_without_its_library_is_said(surrounded, monkeypatch):
    surrounded()
    monkeypatch.setattr(surroundings.ctypes.util, "find_library", lambda name: None)
    found = {what: (fine, words) for what, fine, words in doctor()}
    assert found["camera backend aravis"][0] is False
    assert "libaravis" in found["camera backend aravis"][1]
    monkeypatch.setattr(surroundings, "find_spec", lambda name: None)
    found = {what: (fine, words) for what, fine, words in doctor()}
    for backend, extra in (("harvesters", "rtpiv[camera]"), ("micromanager", "rtpiv[micromanager]")):
        assert found[f"camera backend {backend}"][0] is False
        assert extra in found[f"camera backend {backend}"][1]
    assert found["camera backend files"] == (True, "installed")
