"""Children find our modules, whatever the folder holds in which they are started."""

import subprocess
from importlib.metadata import version

from daq.child import child


def test_a_user_s_files_hide_nothing(tmp_path):
    for name in ("daq.py", "sim.py", "tracer.py"):
        (tmp_path / name).write_text("raise SystemExit('hidden')\n")
    command, environment = child("rtpiv.command_line.cli", "--version")
    ran = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=True)
    assert ran.stdout == f"rtpiv {version('rtpiv')}\n"
