"""Write down which kernels each verb calls for a scene of balls: ``rtpiv/command_line/first_use.json``.

    python -m benchmarks.first_use FOLDER

FOLDER is one that `benchmarks.commands --folder` has left.  Each verb runs once in a process and cache of its own.
"""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from benchmarks.commands import commands

ROOT = Path(__file__).resolve().parents[1]
VERBS = {"trace": "trace", "correct": "correct", "evaluate": "evaluate", "calibrate": "calibrate"}
RECORD = """
import json, sys, time
import rtpiv.command_line.first_use
from rtpiv.command_line.cli import main
calls = []
class Recorder:
    def __init__(self, verb):
        self.form = None
    def start(self, place, form):
        self.form, self.since = form, time.process_time()
    def finish(self, place):
        if self.form is not None:
            calls.append((place, self.form, round(time.process_time() - self.since, 2)))
        self.form = None
rtpiv.command_line.first_use.FirstUse = Recorder
code = main(sys.argv[2:])
with open(sys.argv[1], "w") as told:
    json.dump(calls, told)
sys.exit(code)
"""


def main() -> None:
    """Record all verbs."""
    folder = Path(sys.argv[1])
    kept = {}
    for name, verb in VERBS.items():
        with tempfile.TemporaryDirectory() as cache:
            told = Path(cache) / "calls.json"
            environment = {**os.environ, "RTPIV_CACHE": cache, "RTPIV_THREADS": "1"}
            words = [sys.executable, "-c", RECORD, str(told), *commands(folder)[name]]
            subprocess.run(words, env=environment, check=True, stdout=subprocess.DEVNULL)
            kept[verb] = json.loads(told.read_text())
            print(f"{verb}: {len(kept[verb])} kernels, {sum(call[2] for call in kept[verb]):.0f} s")
    lines = [f' "{verb}": [\n  ' + ",\n  ".join(map(json.dumps, calls)) + "\n ]" for verb, calls in kept.items()]
    (ROOT / "rtpiv" / "command_line" / "first_use.json").write_text(
        "{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8"
    )


if __name__ == "__main__":
    main()
