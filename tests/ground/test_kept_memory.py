"""Memory of a worker that others have started: pages are asked of the system once, not for every frame."""

import os
import subprocess
import sys

import pytest

FRAMES = """
import resource, sys
from concurrent.futures import ThreadPoolExecutor
import numpy as np
from ground.kept_memory import keep_memory

def pages():
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for _ in range(25):
        frames = [np.ones(1_000_000) for _ in range(4)]
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before

with ThreadPoolExecutor(1) as second_thread:
    second_thread.submit(np.ones, 1000).result()
    kept = sys.argv[1] == "keep" and keep_memory()
    print(kept, second_thread.submit(pages).result())
"""
PAGES = 25 * 4 * 8_000_000 // 4096


def asked_pages(word: str) -> tuple[str, int]:
    """What 100 arrays of 8 MB cost, as one of Dask's workers would make them."""
    given = os.environ | {"MALLOC_TRIM_THRESHOLD_": "65536", "NUMPY_MADVISE_HUGEPAGE": "0"}
    command = [sys.executable, "-c", FRAMES, word]
    done = subprocess.run(command, env=given, capture_output=True, text=True, check=True)
    kept, pages = done.stdout.split()
    return kept, int(pages)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="other systems have other ways")
def test_pages_are_asked_for_once() -> None:
    kept, pages = asked_pages("keep")
    if kept != "True":
        pytest.skip("the C library is not glibc")
    assert pages < 0.1 * PAGES
    assert asked_pages("leave")[1] > 0.5 * PAGES
