"""Programs that are not ours judge the simulated camera: Harvesters' own test suite, arv-tool, arv-test.

The GigE judges run in a network namespace of their own, because arv-test finds its devices by broadcast.
"""

import importlib.util
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from sim.camera.config import CameraConfig
from sim.camera.gentl import write_producer

SERVE = """
import sys, time
from sim.camera.config import CameraConfig
from sim.camera.gige import GigeDevice
with GigeDevice(CameraConfig(width=512, height=512, serial="J1"), "127.0.0.1", is_discoverable=True):
    print("up", flush=True)
    sys.stdin.read()
"""
# Of the chunk data that ours sends; of cameras that it does not know the judge asks for others.
ARV_TEST_CONFIG = "[rtpiv:SimCamera]\nChunkList=Timestamp CounterValue\n"


@pytest.mark.slow
def test_harvesters_own_suite_on_our_producer(tmp_path):
    if importlib.util.find_spec("harvesters") is None:
        pytest.skip("harvesters is not installed (extra rtpiv[camera])")
    import harvesters.test

    cti = write_producer(
        tmp_path / "judged.cti", [CameraConfig(width=128, height=96, serial=f"J{index}") for index in range(3)]
    )
    suite = str(Path(harvesters.test.__file__).parent)
    # Its threads share a node map whose lock is taken with Python's lock held; letting Python switch threads
    # inside our callbacks would stop both for ever, so it switches only where a thread waits.
    options = ["-q", "-p", "no:cacheprovider", "-W", "ignore", "--rootdir", str(tmp_path), suite]
    code = f"import sys, pytest; sys.setswitchinterval(1e3); sys.exit(pytest.main({options!r}))"
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | {"HARVESTERS_TEST_TARGET": str(cti)},
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=280,
        check=False,
    )
    summary = re.search(r"(\d+) passed, (\d+) skipped", done.stdout)
    assert done.returncode == 0, done.stdout[-3000:]
    assert summary is not None
    assert int(summary.group(1)) >= 90
    assert int(summary.group(2)) <= 30  # bound to TLSimu's own names and features


def in_namespace(*command, timeout_s=120):
    """Run a command beside a device on a loopback of its own."""
    for tool in ("unshare", "ip", command[0]):
        if shutil.which(tool) is None:
            pytest.skip(f"{tool} is not installed")
    if subprocess.run(["unshare", "-rn", "true"], capture_output=True, check=False).returncode:
        pytest.skip("this machine allows no network namespaces to ordinary users")
    script = (
        "import subprocess, sys\n"
        "subprocess.run(['ip', 'link', 'set', 'lo', 'up'], check=True)\n"
        f"serve = [sys.executable, '-c', {SERVE!r}]\n"
        "device = subprocess.Popen(serve, stdin=subprocess.PIPE, stdout=subprocess.PIPE)\n"
        "device.stdout.readline()\n"
        f"done = subprocess.run({list(command)!r})\n"
        "device.stdin.close()\n"
        "device.wait()\n"
        "sys.exit(done.returncode)\n"
    )
    command = ["unshare", "-rn", sys.executable, "-c", script]
    return subprocess.run(command, capture_output=True, text=True, timeout=timeout_s, check=False)


@pytest.mark.slow
def test_arv_tool_reads_and_writes_our_device():
    names = ["Width", "PixelFormat=Mono12p", "PixelFormat", "ExposureTime=1234", "ExposureTime", "PayloadSize"]
    done = in_namespace("arv-tool-0.8", "-a", "127.0.0.1", "control", *names)
    values = dict(re.findall(r"^(\w+) = (\S+)", done.stdout, re.MULTILINE))
    assert values["Width"] == "512"
    assert values["PixelFormat"] == "Mono12p"
    assert values["ExposureTime"] == "1234"
    assert values["PayloadSize"] == str(512 * 512 * 12 // 8)


@pytest.mark.slow
@pytest.mark.parametrize("socket_kind", [[], ["--packet-socket"]], ids=["udp-socket", "packet-socket"])
def test_arv_test_finds_nothing_to_complain_about(tmp_path, socket_kind):
    config = tmp_path / "arv.cfg"
    config.write_text(ARV_TEST_CONFIG)
    done = in_namespace("arv-test-0.8", "-c", str(config), *socket_kind)
    results = dict(re.findall(r"^(\w+:\w+)\s+(\w+)", done.stdout, re.MULTILINE))
    assert [name for name, result in results.items() if result == "FAILURE"] == [], done.stdout
    passed = {name for name, result in results.items() if result == "SUCCESS"}
    assert {
        "Genicam:Load",
        "Properties:GainReadout",
        "MultipleAcquisitionA:BufferCheck",
        "MultipleAcquisitionA:FrameRate",
        "SingleAcquisition:BufferCheck",
        "SoftwareTrigger:BufferCheck",
        "Chunks:BufferCheck",
        "GigEVision:StreamChannel",
    } <= passed
