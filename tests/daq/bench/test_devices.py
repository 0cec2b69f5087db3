"""Devices by name: opened in order, closed in reverse, simulated each, and a kind of another project works too."""

from contextlib import contextmanager, suppress

import pytest

from daq.bench.bench_file import load_bench
from daq.bench.kinds import KINDS, kind_of
from daq.bench.opened import open_bench
from ground.config import Table
from ground.errors import ConfigError
from tests.daq.cameras.rigs import need_harvesters
from tests.daq.small_bench import write_bench

HERE = __name__


class LampSection(Table):
    """What a bench file says of a lamp."""

    port: str
    volt: float = 5.0


class LampKind:
    """A toy kind of device."""

    section = LampSection
    simulator = f"{HERE}:simulated_lamp"
    said: list = []  # noqa: RUF012 - one story of a test

    @contextmanager
    def open(self, section, bench, clock):
        self.said.append(f"on {section.port}")
        try:
            yield section.volt
        finally:
            self.said.append(f"off {section.port}")

    def places(self, section):
        yield f"lamp: {section.port}"


@contextmanager
def simulated_lamp(section, world, clock):
    LampKind.said.append("simulated")
    assert world.true_mm()
    yield section.model_copy(update={"port": "sim://" + section.port})
    LampKind.said.append("taken down")


@pytest.fixture
def said(monkeypatch):
    monkeypatch.setitem(KINDS, "lamp", f"{HERE}:LampKind")
    monkeypatch.setattr(LampKind, "said", [])
    return LampKind


def bench_with(folder, devices):
    path = write_bench(folder)
    path.write_text(path.read_text() + f"devices:\n{devices}")
    return path


LAMPS = "  left: {kind: lamp, port: one}\n  right: {kind: lamp, port: two, volt: 12.0}\n"


def test_they_are_opened_in_order_and_closed_in_reverse(tmp_path, said, mocker):
    mocker.patch("daq.bench.kinds.make_camera")
    bench = load_bench(bench_with(tmp_path, LAMPS))
    assert list(bench.devices) == ["stages", "camera", "left", "right"]
    with suppress(ZeroDivisionError), open_bench(bench, True) as hardware:
        assert (hardware.devices["left"], hardware.devices["right"]) == (5.0, 12.0)
        assert list(kind_of("lamp").places(hardware.sections["right"])) == ["lamp: sim://two"]
        _ = 1 / 0  # something happens meanwhile
    assert said.said == [
        "simulated", "simulated", "on sim://one", "on sim://two",
        "off sim://two", "off sim://one", "taken down", "taken down",
    ]  # fmt: skip


def test_only_what_is_needed_is_opened(tmp_path, said):
    with open_bench(load_bench(bench_with(tmp_path, LAMPS)), True, only={"stages", "right"}) as hardware:
        assert list(hardware.devices) == ["stages", "right"]
    assert "on sim://one" not in said.said


def test_what_cannot_be_opened_takes_the_others_down(tmp_path, said, mocker):
    make = mocker.patch("daq.bench.kinds.make_camera")
    mocker.patch.object(LampKind, "open", side_effect=OSError("no lamp"))
    with pytest.raises(OSError, match="no lamp"), open_bench(load_bench(bench_with(tmp_path, LAMPS)), True):
        pass
    assert make.return_value.close.called


def test_a_kind_of_another_project_is_named_with_its_module(tmp_path, said):
    bench = load_bench(bench_with(tmp_path, f'  left: {{kind: "{HERE}:LampKind", port: one}}\n'))
    with open_bench(bench, True, only={"left"}) as hardware:
        assert hardware.devices == {"left": 5.0}


@pytest.mark.parametrize(
    ("devices", "words"),
    [
        ("  left: {port: one}\n", r"bench\.yaml:\d+: devices\.left: set its kind"),
        ("  left: {kind: torch, port: one}\n", r"bench\.yaml:\d+: there is no kind of device 'torch'"),
        ("  left: {kind: lamp, prt: one}\n", r"bench\.yaml:\d+: unknown key 'prt'; did you mean 'port'"),
        ("  left:\n    kind: lamp\n    port: one\n    volt: high\n", r"volt: should be a number"),
        ("  left: {kind: \"nowhere:Lamp\", port: one}\n", r"kind of device 'nowhere:Lamp' cannot be loaded"),
        ("  camera: {kind: camera, backend: files}\n", r"devices\.camera: that device has a section of its own"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_said_with_its_line(tmp_path, said, devices, words):
    with pytest.raises(ConfigError, match=words):
        load_bench(bench_with(tmp_path, devices))


def test_lines_are_those_of_the_bench_file(tmp_path, said):
    path = bench_with(tmp_path, "  left:\n    kind: lamp\n    port: one\n    volt: high\n")
    with pytest.raises(ConfigError) as caught:
        load_bench(path)
    line = caught.value.problems[0].line
    assert "volt: high" in path.read_text().splitlines()[line - 1]


@pytest.mark.slow
def test_a_second_camera_is_another_one_and_sees_its_own_scene(tmp_path):
    need_harvesters()
    text = "  second: {kind: camera, scene: other.yaml, backend: files, options: {folder: f}}\n"
    path = bench_with(tmp_path, text)
    scene = (path.parent / "scene.yaml").read_text()
    (path.parent / "other.yaml").write_text(scene.replace("sensor_px: [96, 96]", "sensor_px: [64, 48]"))
    bench = load_bench(path)
    assert bench.devices["second"].section.backend == "files"
    assert bench.as_seen_by("second").scene.camera.sensor_px == (64, 48)
    assert bench.as_seen_by("camera").content_hash() == bench.content_hash()
    with open_bench(bench, True, only={"camera", "second"}) as hardware:
        first, second = (hardware.devices[name] for name in ("camera", "second"))
        assert (first.info.serial, second.info.serial) == ("SIM-BENCH", "SIM-BENCH-second")
        sides = [[camera.settings()[side] for side in ("Width", "Height")] for camera in (first, second)]
        assert sides == [[96, 96], [64, 48]]


def test_its_port_may_be_replaced_and_nothing_else(tmp_path, said):
    texts = [LAMPS, LAMPS.replace("one", "three"), LAMPS.replace("12.0", "13.0")]
    first, other_port, other_volt = (
        load_bench(bench_with(tmp_path / str(n), text)).content_hash() for n, text in enumerate(texts)
    )
    assert first == other_port != other_volt
