"""Features that depend on one another, set on cameras as several makers describe them, through both libraries.

The judge is the camera itself: it notes every write with the selectors of that moment, and whether it took it.
"""

import json
import re

import pytest

from daq.cameras.sfnc import apply_settings, verify_settings
from daq.errors import SettingRefused
from sim.camera.config import CameraConfig
from sim.camera.device import SimCamera
from tests.daq.cameras import dialects
from tests.daq.cameras.rigs import AravisRig, HarvestersRig, need_harvesters

SOFTWARE = {"TriggerMode": "On", "TriggerSource": "Software"}
FRAME, BURST, ACQUISITION = (
    {"TriggerSelector": name, **SOFTWARE} for name in ("FrameStart", "FrameBurstStart", "AcquisitionStart")
)
EXPOSURE = {"TriggerSelector": "ExposureStart", **SOFTWARE}
OLD_SWITCHES = {"AcquisitionFrameRateEnabled": True, "AcquisitionFrameRateAuto": "Off"}
RIGHT = [  # dialect, settings, and what else changes
    ("blackfly_s", {"ExposureAuto": "Off", "ExposureTime": 2000.0}, {}),
    ("blackfly_s", {"ExposureTime": 2000.0, "ExposureAuto": "Off"}, {}),
    ("blackfly_s", {"Gain": 6.0, "GainAuto": "Off"}, {}),
    ("blackfly_s", {"AcquisitionFrameRate": 5.0}, {"AcquisitionFrameRateEnable": True}),
    ("blackfly_s", {"AcquisitionFrameRate": 5.0, "AcquisitionFrameRateEnable": True}, {}),
    ("blackfly_s", {**FRAME, "PixelFormat": "Mono8", "Width": 32}, {}),
    ("blackfly_s", {**BURST, "TriggerActivation": "FallingEdge", "TriggerDelay": 25.0}, {}),
    ("grasshopper", {"AcquisitionFrameRate": 5.0}, OLD_SWITCHES),
    ("grasshopper", {"AcquisitionFrameRate": 5.0, **OLD_SWITCHES}, {}),
    ("grasshopper", {"AcquisitionFrameRate": 5.0, "AcquisitionFrameRateEnable": True}, OLD_SWITCHES),
    ("grasshopper", {"ExposureTime": 50.0, "Gain": 3.0, "ExposureAuto": "Off", "GainAuto": "Off", **FRAME}, {}),
    ("flea3", EXPOSURE, {}),
    ("ace", {"ExposureTime": 2000.0, "AcquisitionFrameRate": 12.0}, {"AcquisitionFrameRateEnable": True}),
    ("ace", {"ExposureTimeAbs": 2000.0, "AcquisitionFrameRateAbs": 12.0}, {"AcquisitionFrameRateEnable": True}),
    ("ace", {"GainRaw": 100, "GainSelector": "AnalogAll"}, {}),
    ("ace", {"GainRaw": 77, "GainSelector": "Tap2", **FRAME}, {}),
    ("ace", {"TriggerDelay": 10.0, "TriggerSelector": "FrameStart"}, {}),
    ("pilot", ACQUISITION, {}),
    ("manta", {"ExposureTime": 2000.0, "AcquisitionFrameRate": 12.0}, {}),
    ("manta", {"GainSelector": "All", "Gain": 3.0, **FRAME}, {}),
    ("manta", ACQUISITION, {}),
    ("vieworks", {"Gain": 6.0, "GainSelector": "AnalogAll"}, {}),
    ("vieworks", {"GainSelector": "DigitalAll", "Gain": 6.0, **EXPOSURE}, {}),
    ("hikrobot", {**BURST, "AcquisitionBurstFrameCount": 1}, {}),
    ("plain", FRAME, {}),
    ("plain", {"GainSelector": "All", "Gain": 2.0}, {}),
    ("plain", {"ExposureTime": 500.0, "ExposureMode": "Timed"}, {}),
]
REFUSED = [  # dialect, settings, reason
    ("blackfly_s", {"ExposureTime": 2000.0, **FRAME}, r"ExposureTime.*ExposureAuto is Continuous"),
    ("blackfly_s", {"AcquisitionFrameRateEnable": False, "AcquisitionFrameRate": 5.0}, r"Rate\b.*Enable is False"),
    (
        "blackfly_s",
        {"ExposureMode": "TriggerWidth", "ExposureAuto": "Off", "ExposureTime": 9.0},
        r"is TriggerWidth",
    ),
    ("blackfly_s", {"GainAuto": "off", "Gain": 3.0}, r"GainAuto = 'off'"),
    ("grasshopper", {"AcquisitionFrameRate": 5.0, **FRAME}, r"AcquisitionFrameRate\b.*TriggerMode is On"),
    ("flea3", {**FRAME, "Width": 32}, r"TriggerSelector = 'FrameStart'.*set TriggerSelector: ExposureStart$"),
    ("ace", {"Gain": 3.0, **FRAME}, r"no feature Gain\b.*it has GainRaw"),
    ("ace", {"GainSelector": "Tap1", "GainRaw": 1000}, r"GainRaw = 1000 is refused"),
    ("ace", {"GainSelector": "Tap3", "GainRaw": 100, "GainAuto": "Off"}, r"GainSelector = 'Tap3'"),
    ("pilot", FRAME, r"TriggerSelector = 'FrameStart'.*AcquisitionStart"),
    ("hikrobot", FRAME, r"set TriggerSelector: FrameBurstStart and AcquisitionBurstFrameCount: 1$"),
    ("plain", {"TriggerSource": "Software"}, r"TriggerSource.*TriggerMode is Off"),
    ("plain", {"TriggerSoftware": 1}, r"TriggerSoftware"),
    ("plain", {"AcquisitionControl": 1, "Gain": 2.0}, r"AcquisitionControl"),
    ("plain", {"TriggerSelector": "AcquisitionStart", **SOFTWARE}, r"no feature TriggerSelector"),
]


def config_of(dialect, **changes):
    return CameraConfig(64, 48, features=f"{dialects.__name__}:{dialect.upper()}", **changes)


class NodeMapRig:
    """Cameras without a process and frames: their registers behind the node map of genicam, in this process."""

    def __init__(self, folder):
        need_harvesters()

    def make(self, config):
        from genicam import genapi

        from daq.cameras.genicam_objects import GenApiNodes

        class Port(genapi.AbstractPort):
            def get_access_mode(self):
                return genapi.EAccessMode.RW

            def read(self, address, length):
                return device.read(address, length)

            def write(self, address, buffer):
                device.write(address, bytes(buffer))

        device, node_map = SimCamera(config), genapi.NodeMap()
        node_map.load_xml_from_string(device.registers.xml.decode())
        port = Port()
        node_map.connect(port, "Device")
        return FeaturesAlone(GenApiNodes(node_map), device, port)

    def close(self):
        pass


class FeaturesAlone:
    """What a camera's process does with settings, without the process."""

    def __init__(self, nodes, device, port):
        self._nodes, self._device, self._port, self._set = nodes, device, port, {}

    def open(self):
        pass

    def configure(self, settings):
        self._set = apply_settings(self._nodes, settings)
        return self._set

    def verify(self):
        verify_settings(self._nodes, self._set)

    def close(self):
        self._device.power_off()


def behind_both(rows, *fast):
    """Rows with a rig; a Harvesters camera is a process, so that all but the fast rows of these are slow."""
    processes = [
        pytest.param(HarvestersRig, *row, marks=() if number in fast else pytest.mark.slow)
        for number, row in enumerate(rows)
    ]
    return processes + [pytest.param(AravisRig, *row) for row in rows]


def behind_all(rows):
    """The same with the node map alone, all of them fast."""
    return [pytest.param(NodeMapRig, *row) for row in rows] + behind_both(rows, 0)


@pytest.fixture(scope="module", params=[NodeMapRig, HarvestersRig, AravisRig])
def rig(request, tmp_path_factory):
    rig = request.param(tmp_path_factory.mktemp("rig"))
    yield rig
    rig.close()


@pytest.fixture
def camera_of(rig, tmp_path):
    made = []

    def make(dialect, **changes):
        made.append(rig.make(config_of(dialect, write_log=str(tmp_path / "writes"), **changes)))
        made[-1].open()
        return made[-1]

    (tmp_path / "writes").touch()
    yield make
    for camera in made:
        camera.close()


class Table:
    """A dialect's features by the names that its description shows."""

    def __init__(self, dialect):
        features = [feature for feature in getattr(dialects, dialect.upper()) if feature.shown is not None]
        self.names = {feature.name: feature.shown or feature.name for feature in features}
        self._features = {self.names[feature.name]: feature for feature in features}
        self._selectors = {self.names[n]: f.name for f in features for n in f.selects if n in self.names}

    def changed(self, written):
        """What differs from power-up after writes of (name, value, entries of selectors), by name and entry."""
        now = {}
        for name, value, selection in written:
            feature = self._features[name]
            key = name, selection.get(self._selectors.get(name)) if feature.is_per_entry else None
            now[key] = value
            power_up = next(
                (entry for entry, number in feature.entries if number == feature.default), feature.default
            )
            if value == power_up:
                del now[key]
        return now

    def first_entries(self):
        return {name: feature.entries[0][0] for name, feature in self._features.items() if feature.selects}


def judge(dialect, log):
    lines = [json.loads(line) for line in log.read_text().splitlines()]
    lines = [line for line in lines if not line[0].startswith("GevSCPS")]  # the library's own
    assert all(is_taken for *_, is_taken in lines), "written while it was locked"
    return Table(dialect).changed(line[:3] for line in lines)


@pytest.mark.parametrize(("rig", "dialect", "settings", "others"), behind_all(RIGHT), indirect=["rig"], ids=str)
def test_what_is_asked_is_set_and_nothing_elsewhere(camera_of, tmp_path, dialect, settings, others):
    camera, table = camera_of(dialect), Table(dialect)
    readback = camera.configure(settings)
    camera.verify()
    without = {name: value for name, value in settings.items() if name not in readback}
    assert without in ({}, {"TriggerSelector": "FrameStart"}, {"GainSelector": "All"})
    there = {name: value for name, value in settings.items() if name not in without}
    assert readback == pytest.approx(there)
    selection = table.first_entries() | {name: value for name, value in there.items() if "Selector" in name}
    wanted = {table.names.get(name, name): value for name, value in {**there, **others}.items()}
    assert judge(dialect, tmp_path / "writes") == table.changed((n, v, selection) for n, v in wanted.items())


TRIGGERED = [(name,) for name in ("hikrobot", "blackfly_s", "ace", "flea3", "manta", "plain")]


@pytest.mark.parametrize(("rig", "dialect"), behind_both(TRIGGERED, 0, 2), indirect=["rig"], ids=str)
def test_the_trigger_that_was_set_takes_a_frame(camera_of, dialect):
    camera = camera_of(dialect, id_bits=16, first_frame_id=65534)
    selector = {"flea3": EXPOSURE, "hikrobot": {**BURST, "AcquisitionBurstFrameCount": 1}}.get(dialect, FRAME)
    camera.configure(selector)
    camera.arm()
    sequences = []
    for _ in range(4):  # the ids wrap behind a producer whose type says nothing
        camera.trigger()
        sequences.append(camera.next_frame(2.0).copy().meta.sequence)
    assert (sequences, camera.disarm().missing) == ([0, 1, 2, 3], 0)


@pytest.mark.parametrize(("rig", "dialect", "settings", "reason"), behind_all(REFUSED), indirect=["rig"], ids=str)
def test_what_cannot_be_set_is_refused_with_its_reason_and_put_back(
    camera_of, tmp_path, dialect, settings, reason
):
    camera = camera_of(dialect)
    with pytest.raises(SettingRefused) as refusal:
        camera.configure(settings)
    assert re.search(reason, str(refusal.value)), refusal.value
    assert judge(dialect, tmp_path / "writes") == {}


def test_what_a_refused_selector_selects_is_not_written_at_all(camera_of, tmp_path):
    with pytest.raises(SettingRefused, match="GainSelector = 'Tap3'"):
        camera_of("blackfly_s").configure({"GainSelector": "Tap3", "Gain": 3.0, "GainAuto": "Off"})
    assert not any("GainAuto" in line for line in (tmp_path / "writes").read_text().splitlines())
