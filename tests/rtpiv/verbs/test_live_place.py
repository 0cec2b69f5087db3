"""`rtpiv live --simulate`: a correction is for one place, and simulated axes begin at another."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from daq.bench.bench_file import load_bench
from daq.bench.bench_table import Bench
from daq.bench.opened import OpenBench
from rtpiv.verbs.init import init
from rtpiv.verbs.live import _away, _snapshot


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Bench:
    folder = tmp_path_factory.mktemp("lab")
    init(folder)
    return load_bench(folder / "bench.yaml")


def hardware(true_mm: dict[str, float] | None) -> OpenBench:
    simulation = None if true_mm is None else SimpleNamespace(true_mm=lambda: true_mm)
    return cast("OpenBench", SimpleNamespace(simulation=simulation))


def test_axes_that_stand_elsewhere_are_named(bench: Bench) -> None:
    at_home = bench.home_mm
    assert _away(bench, hardware(at_home)) == ""
    assert _away(bench, hardware(None)) == ""  # nobody knows at a real bench
    said = _away(bench, hardware(at_home | {"glass_y": at_home["glass_y"] - 48.3}))
    where, cure = said.split("; ")
    assert where == "simulated axes stand off the place in the scene file: glass_y by -48.3 mm"
    assert cure == f"see a run corrected: rtpiv acquire PLAN --bench {bench.path} --simulate --home --live"


def test_the_page_says_so_and_draws_no_outlines(bench: Bench) -> None:
    meta = SimpleNamespace(received_ns=0, significant_bits=12)
    frame: Any = SimpleNamespace(meta=meta, pixels=np.zeros((4, 4), np.uint16))
    words, pictures = _snapshot(bench, frame, None, "chessboard", 0, 0.0, "glass_y stands elsewhere")
    assert words["doing"] == "no correction: glass_y stands elsewhere"
    assert words["view"] == ""
    assert words["rims"] is False
    assert list(pictures) == ["raw"]
