"""Memory of a series does not grow with the number of its pairs."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[4]
FIRST_PAIRS, MOST_MB = 20, 50


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_a_hundred_pairs_need_no_more_memory_than_twenty(tmp_path):
    words = ("--pairs", "100", "--side", "504", "--chunk", "4", "--workers", "1", "-o", str(tmp_path))
    command = [sys.executable, "-m", "benchmarks.series", *words]
    said = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    found = json.loads(said.partition(": ")[2])["resident_MB_by_pairs"]
    by_pairs = {int(pairs): resident for pairs, resident in found.items()}
    assert max(by_pairs) == 100
    later = [resident for pairs, resident in by_pairs.items() if pairs >= FIRST_PAIRS]
    assert max(later) - later[0] <= MOST_MB, by_pairs
