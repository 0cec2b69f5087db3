"""docs/python.md: its scripts run as they stand in a lab of `rtpiv init`, and print what a person can read."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from rtpiv.verbs.init import GivenLab, init

PAGE = Path(__file__).resolve().parents[2] / "docs" / "python.md"


def scripts():
    """Indented blocks of the page that are more than an import."""
    text = PAGE.read_text(encoding="utf-8")
    blocks = re.findall(r"(?:^    .*\n|^\n)+", text, re.MULTILINE)
    found = [re.sub(r"^    ", "", block, flags=re.MULTILINE).strip() for block in blocks]
    return [block for block in found if len(re.findall(r"^\S", block, re.MULTILINE)) > 1]


def test_the_page_has_a_campaign_and_a_scan():
    campaign, scan = scripts()
    for script in (campaign, scan):
        compile(script, "python.md", "exec")
    assert "acquire(" in campaign
    assert "RunEngine" in scan


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("number", [0, 1])
def test_the_scripts_of_the_page_run_as_they_stand(number, tmp_path):
    if number == 1:
        pytest.importorskip("bluesky")
    init(tmp_path, GivenLab(balls=1, sensor_px=(504, 504), pixel_pitch_um=11.0))
    (tmp_path / "campaign.py").write_text(scripts()[number] + "\n")
    ran = subprocess.run(
        [sys.executable, "campaign.py"], cwd=tmp_path, env=os.environ, capture_output=True, text=True, check=False
    )
    assert ran.returncode == 0, ran.stderr
    for clumsy in ("np.float64", "Evaluation(", "Traceback", "Task("):
        assert clumsy not in ran.stdout + ran.stderr
    if number == 0:
        assert re.search(r"^camera\.x: -?\d+\.\d{4} \+- \d+\.\d{4}$", ran.stdout, re.MULTILINE)
        assert re.search(r"^\S+: \d+ ", ran.stdout, re.MULTILINE)
