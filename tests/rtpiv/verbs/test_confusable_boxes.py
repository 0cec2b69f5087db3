"""Two boxes of one kind: doctor and acquire say so, and say no more once the bench file ties them."""

import re

import pytest

from daq.bench.bench_file import load_bench
from rtpiv.command_line.cli import DEVICE, DONE, main
from tests.daq.small_bench import FILES_CAMERA, write_bench, write_frames

WARNING = "would be taken for another box on a swapped cable"


@pytest.fixture
def path(tmp_path):
    """The example bench with two PI controllers: the third axis of the target has one of its own."""
    path = write_bench(tmp_path, camera=FILES_CAMERA)
    text = path.read_text()
    text = text.replace(
        "    target: {driver: pi_gcs2, port: /dev/ttyUSB3}\n",
        "    target: {driver: pi_gcs2, port: /dev/ttyUSB3}\n    depth: {driver: pi_gcs2, port: /dev/ttyUSB4}\n",
    )
    assert text.count('controller: target, channel: "3"') == 1
    path.write_text(text.replace('controller: target, channel: "3"', 'controller: depth, channel: "1"'))
    write_frames(tmp_path / "frames_in", 8)
    (tmp_path / "plan.yaml").write_text("experiment: target\nclear: {z_mm: [0.0]}\n")
    return path


def tied(path):
    text = re.sub(r"(port: /dev/ttyUSB([34]))", r'\1, identity: "000000000\2"', path.read_text())
    path.write_text(text)


def words(text):
    return " ".join(re.findall(r"[\w(),-]+", text))


@pytest.mark.posix("ports that are files")
def test_doctor_names_them_until_they_are_tied(path, capsys):
    assert main(["doctor", "--bench", str(path)]) == DEVICE
    said = words(capsys.readouterr().out)
    assert "identity of the boxes" in said
    assert "target and depth (pi_gcs2)" in said
    tied(path)
    assert main(["doctor", "--bench", str(path)]) == DEVICE  # its ports are not here
    assert "identity of the boxes" not in capsys.readouterr().out


def test_acquire_warns_at_its_start(path, capsys):
    files = [str(path.parent / "plan.yaml"), "--bench", str(path), "-o", str(path.parent / "runs")]
    assert main(["acquire", *files, "--dry-run"]) == DONE
    assert WARNING in words(capsys.readouterr().err)
    assert main(["acquire", *files, "--dry-run", "--simulate"]) == DONE
    assert WARNING not in words(capsys.readouterr().err)
    tied(path)
    assert main(["acquire", *files, "--dry-run"]) == DONE
    assert WARNING not in words(capsys.readouterr().err)


def test_another_box_may_go_on_with_a_run_another_bench_may_not(path):
    """An identity is no more part of what a run means than the port is."""
    before = load_bench(path).content_hash()
    tied(path)
    assert load_bench(path).content_hash() == before
    path.write_text(path.read_text().replace("settle_s: 0.5", "settle_s: 0.6"))
    assert load_bench(path).content_hash() != before
