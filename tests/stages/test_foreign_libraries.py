"""The motion contract on libraries of others: Micro-Manager's DemoCamera, ophyd's simulated axes, and an own one.

They move on the wall's clock, in worlds of their own. Where a stage truly is, is asked of the library past our
controller.
"""

import math
import sys
import threading
import time
from types import ModuleType

import pytest

from stages.config import StagesTable
from stages.controller_tables import MicroManagerTable, PositionersTable
from stages.errors import (
    DeviceError,
    MotionStopped,
    NotReferenced,
    PortUnavailable,
    StageUsageError,
    WrongDevice,
)
from stages.stage import Stage
from stages.states import AxisState

pytestmark = pytest.mark.filterwarnings("ignore:.* (is moved|cannot be stopped) by:RuntimeWarning")


class TimedAxis:
    """An axis that moves with time and stops where it is: what ophyd's own simulated ones do not."""

    made: list["TimedAxis"] = []  # noqa: RUF012

    def __init__(self, speed, name):
        self.name, self.speed = name, speed
        self.start, self.target, self.begun_s = 0.0, 0.0, time.monotonic()
        self.made.append(self)

    @property
    def position(self):
        way = self.target - self.start
        gone = min(abs(way), self.speed * (time.monotonic() - self.begun_s))
        return self.start + math.copysign(gone, way)

    @property
    def moving(self):
        return self.position != self.target

    def set(self, value):
        self.start, self.target, self.begun_s = self.position, value, time.monotonic()
        return Done(self)

    def stop(self, success=False):
        self.target = self.position

    def restart(self):
        self.start = self.target = 0.0


class Done:
    success = True

    def __init__(self, axis):
        self.axis = axis

    @property
    def done(self):
        return not self.axis.moving

    def exception(self, timeout=0.0):
        return None


own = ModuleType("tests_own_axes")
own.TimedAxis = TimedAxis
sys.modules["tests_own_axes"] = own


def demo_box():
    adapters = pytest.importorskip("mm_test_adapters")
    pytest.importorskip("pymmcore")
    return {
        "driver": "micromanager", "homing": "hand", "adapters": adapters.device_adapter_path(),
        "devices": {
            "hub": {"library": "DemoCamera", "device": "DHub"},
            "Z": {"library": "DemoCamera", "device": "DStage", "parent": "hub"},
            "XY": {"library": "DemoCamera", "device": "DXYStage", "properties": {"Velocity": 10.0}},
        },
    }  # fmt: skip


def ophyd_box():
    pytest.importorskip("ophyd")
    axes = {name: {"object": "ophyd.sim:SynAxis", "arguments": {"name": name, "delay": 0.2}} for name in "xy"}
    return {"driver": "positioners", "homing": "hand", "objects": axes}


def own_box():
    axes = {n: {"object": "tests_own_axes:TimedAxis", "arguments": {"speed": 10.0, "name": n}} for n in "xy"}
    return {"driver": "positioners", "homing": "hand", "objects": axes}


# box, channels, whether a way takes time and can be stopped
KINDS = {
    "XY of DemoCamera": (demo_box, ("XY/x", "XY/y"), True),
    "Z of DemoCamera": (demo_box, ("Z", "XY/y"), False),
    "SynAxis of ophyd": (ophyd_box, ("x", "y"), False),
    "an own axis": (own_box, ("x", "y"), True),
}


def table(box, channels, limits_mm=(-0.25, 8.0), **changes):
    axis = {
        "controller": "box", "carries": "target", "along": "x", "limits_mm": list(limits_mm), "speed_mm_s": 10.0,
        "acceleration_mm_s2": 1000.0, "settle_s": 0.0, **changes,
    }  # fmt: skip
    axes = {name: {**axis, "channel": channel} for name, channel in zip("ab", channels, strict=True)}
    return StagesTable.model_validate({"controllers": {"box": box}, "axes": axes, "home_order": ["a", "b"]})


@pytest.fixture(params=KINDS)
def library(request):
    return KINDS[request.param]


@pytest.fixture
def stage(library):
    box, channels, _ = library
    with Stage.open(table(box(), channels)) as opened:
        yield opened


def raw_mm(stage, name):
    """What the library itself says, by whatever way our controller does not go."""
    controller, channel = stage.controllers["box"], stage.axis(name).settings.channel
    if hasattr(controller, "_core"):
        core = controller._core
        return {"Z": lambda: core.getPosition("Z"), "XY/x": lambda: core.getXYPosition("XY")[0],
                "XY/y": lambda: core.getXYPosition("XY")[1]}[channel]() * 1e-3  # fmt: skip
    return controller._objects[channel].position


def confirmed(stage):
    stage.home(ask=lambda name: 0.0)
    return stage


def test_it_moves_where_it_is_told_and_knows_where_it_is(stage):
    with pytest.raises(NotReferenced):
        stage.move({"a": 0.1})
    with pytest.raises(StageUsageError, match="confirm a=MM"):
        stage.home()
    confirmed(stage)
    for targets in ({"a": 0.2, "b": 0.3}, {"a": -0.2}, {"b": 0.0}):
        arrivals = stage.move(targets)
        for name, mm in targets.items():
            assert raw_mm(stage, name) == pytest.approx(mm, abs=0.002)
            assert arrivals[name].measured_mm == pytest.approx(mm, abs=0.002)
    assert stage.where_mm() == pytest.approx({"a": -0.2, "b": 0.0}, abs=0.002)


def test_a_word_of_a_person_shifts_the_zero(stage):
    confirmed(stage)
    stage.confirm("a", 0.5)
    stage.move({"a": 0.6})
    assert raw_mm(stage, "a") == pytest.approx(0.1, abs=0.002)


@pytest.mark.parametrize("after_s", [0.02, 0.3])
def test_a_stop_holds_at_any_moment(stage, library, after_s):
    confirmed(stage)
    takes_time = library[2]
    far_mm = 7.0 if takes_time else 0.2
    threading.Timer(after_s, stage.stop).start()
    begun_s, stopped = time.monotonic(), False
    try:
        stage.move({"a": far_mm, "b": 0.2})
    except MotionStopped:
        stopped = True
    assert stopped or (not takes_time and after_s > 0.0)
    assert time.monotonic() - begun_s < after_s + 1.0 or not takes_time
    time.sleep(max(0.0, begun_s + after_s + 0.1 - time.monotonic()))
    rests_mm = raw_mm(stage, "a"), raw_mm(stage, "b")
    if takes_time:
        assert rests_mm[0] < 10.0 * (after_s + 0.2)
    with pytest.raises(MotionStopped, match="clear"):
        stage.move({"b": 0.0})
    time.sleep(0.15)
    assert (raw_mm(stage, "a"), raw_mm(stage, "b")) == rests_mm
    stage.clear_stop()
    if stage.axis("a").state is AxisState.READY:
        stage.move({"a": 0.0})
        assert raw_mm(stage, "a") == pytest.approx(0.0, abs=0.002)


def test_a_restart_in_motion_holds_the_bench():
    with Stage.open(table(own_box(), ("x", "y"))) as stage:
        confirmed(stage)
        stage.move({"a": 1.0})
        threading.Timer(0.2, stage.controllers["box"]._objects["x"].restart).start()
        with pytest.raises(MotionStopped, match="restarted"):
            stage.move({"a": 7.0})
        assert stage.is_held
        assert stage.where_mm() == {"a": None, "b": None}


class PatientAxis(TimedAxis):
    """Returns from ``set`` when it has arrived, as some adapters do."""

    def set(self, value):
        status = super().set(value)
        time.sleep(abs(value - self.start) / self.speed)
        return status


def test_a_library_that_waits_is_stopped_at_the_end_of_the_leg(monkeypatch):
    """A stop cannot reach into the call: docs/safety.md says so; it holds, and what was to follow never begins."""
    monkeypatch.setattr(own, "TimedAxis", PatientAxis)
    with Stage.open(table(own_box(), ("x", "y"))) as stage:
        confirmed(stage)
        begins, send = threading.Event(), PatientAxis.set
        monkeypatch.setattr(PatientAxis, "set", lambda axis, value: (begins.set(), send(axis, value))[1])

        def stop_in_the_call():
            begins.wait(10.0)
            time.sleep(0.1)
            stage.stop()

        threading.Thread(target=stop_in_the_call).start()
        with pytest.raises(MotionStopped):
            stage.move({"a": 4.0, "b": 1.0})
        assert (raw_mm(stage, "a"), raw_mm(stage, "b")) == (4.0, 0.0)
        assert stage.is_held
        stage.clear_stop()
        assert stage.where_mm() == pytest.approx({"a": 4.0, "b": 0.0})


def test_a_failing_object_is_an_error(monkeypatch):
    class Fails(Done):
        done, success = True, False

        def exception(self, timeout=0.0):
            return RuntimeError("following error")

    with Stage.open(table(own_box(), ("x", "y"))) as stage:
        confirmed(stage)
        monkeypatch.setattr(TimedAxis, "set", lambda self, value: Fails(self))
        with pytest.raises(DeviceError, match="following error"):
            stage.move({"a": 1.0})


def test_what_is_no_positioner_is_refused():
    box = {"driver": "positioners", "homing": "hand", "objects": {n: {"object": "builtins:dict"} for n in "xy"}}
    with pytest.raises(WrongDevice, match="has no set and no stop and no position"):
        Stage.open(table(box, ("x", "y")))
    box["objects"]["x"]["object"] = "nowhere.at.all:Axis"
    with pytest.raises(PortUnavailable, match="cannot be imported"):
        Stage.open(table(box, ("x", "y")))


# ---- Micro-Manager's own words -----------------------------------------------------------------


def test_it_says_who_it_is_and_what_a_stop_cannot_reach():
    with (
        pytest.warns(RuntimeWarning, match="a stop waits for the call in progress"),
        Stage.open(table(demo_box(), ("Z", "XY/x"))) as stage,
    ):
        assert "DemoCamera DXYStage" in stage.controllers["box"].identity


@pytest.mark.parametrize(
    ("device", "text"),
    [
        ({"library": "Nowhere", "device": "DStage"}, "Failed to load device adapter"),
        ({"library": "DemoCamera", "device": "Nothing"}, "failed to instantiate"),
        ({"library": "DemoCamera", "device": "DStage", "properties": {"Speed": 1}}, "Invalid property name"),
    ],
)
def test_devices_that_are_not_there(device, text):
    box = demo_box()
    box["devices"]["Z"] = device
    with pytest.raises(PortUnavailable, match=text):
        Stage.open(table(box, ("Z", "XY/x")))


@pytest.mark.parametrize("channels", [("XY", "Z"), ("Z/x", "Z/y"), ("hub", "Z")])
def test_devices_that_are_no_such_stage(channels):
    with pytest.raises(WrongDevice, match="is not"):
        Stage.open(table(demo_box(), channels))


def test_a_stage_whose_adapter_cannot_home_says_so():
    for channels, text in ((("Z", "XY/x"), "Unsupported device command"), (("XY/x", "XY/y"), "has not moved")):
        with Stage.open(table({**demo_box(), "homing": "device"}, channels)) as stage:
            stage.controllers["box"]._core.setXYPosition("XY", 1000.0, 0.0)
            time.sleep(0.3)
            with pytest.raises(DeviceError, match="homing: hand") as failed:
                stage.home()
            assert text in str(failed.value)


def test_a_configuration_file_of_micro_manager(tmp_path):
    lines = [
        "Property,Core,Initialize,0", "Device,DHub,DemoCamera,DHub", "Device,XY,DemoCamera,DXYStage",
        "Parent,XY,DHub", "Property,Core,Initialize,1",
    ]  # fmt: skip
    box = {**demo_box(), "config": "glass.cfg"}
    del box["devices"]
    config = table(box, ("XY/x", "XY/y"))
    (tmp_path / "glass.cfg").write_text("\n".join(lines))
    with Stage.open(config.beside(tmp_path)) as stage:
        confirmed(stage)
        stage.move({"a": 0.5})
        first = stage.controllers["box"].identity
        assert "glass.cfg" in first
    (tmp_path / "glass.cfg").write_text("\n".join([*lines, "# changed"]))
    with Stage.open(config.beside(tmp_path)) as stage:
        assert stage.controllers["box"].identity != first
    (tmp_path / "glass.cfg").write_text("\n".join([*lines, "ConfigGroup,System,Startup,XY,Position,3.0"]))
    with pytest.raises(StageUsageError, match=r"glass.cfg:6: opening must not move anything"):
        Stage.open(config.beside(tmp_path))
    (tmp_path / "glass.cfg").unlink()
    with pytest.raises(PortUnavailable, match="cannot be read"):
        Stage.open(config.beside(tmp_path))


def test_what_this_computer_lacks_is_seen_without_loading_anything(tmp_path):
    def lacks(**changes):
        about = {
            "homing": "hand",
            "devices": {"Z": {"library": "L", "device": "D"}},
            "core": "json:loads",
            **changes,
        }
        return MicroManagerTable(driver="micromanager", **about).lacks()

    assert lacks() is None
    assert "rtpiv[micromanager]" in lacks(core="not_there_at_all:Core")
    assert "there is no folder" in lacks(adapters=str(tmp_path / "none"))
    assert "there is no file" in lacks(devices={}, config="none.cfg")
    box = {"driver": "positioners", "homing": "hand", "objects": {"x": {"object": "not_there:Axis"}}}
    assert "not_there:Axis is not installed" in PositionersTable.model_validate(box).lacks()
