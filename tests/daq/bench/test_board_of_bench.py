"""The board file that a bench names: read with it, wrong with it, printed in its simulation."""

from dataclasses import replace

import numpy as np
import pytest
import yaml

from correction.target import Chessboard
from correction.target.board_file import PrintedBoard, write_board
from daq.bench.bench_file import load_bench
from ground.errors import ConfigError
from sim.bench import SimulatedBench
from sim.renderer.patterns import Chessboard as Print
from sim.renderer.patterns import CodedBoard, DotGrid, Plate
from tests.daq.small_bench import write_bench
from tracer.board import LARGE_DOTS

PRINTED = PrintedBoard(
    kind="chessboard", square_mm=5.0, disc_mm=2.0, bars_mm=[190.0, 280.0], measured_mm=[190.19, 279.72]
)


def bench_with(folder, target, printed=PRINTED):
    """Write a bench whose target section is this."""
    path = write_bench(folder)
    tree = yaml.safe_load(path.read_text())
    tree["target"] = target
    path.write_text(yaml.safe_dump(tree, sort_keys=False))
    if printed is not None:
        write_board(folder / "board.yaml", printed)
    return path


def test_a_bench_has_the_board_of_its_file_with_the_scale_of_the_print(tmp_path):
    bench = load_bench(bench_with(tmp_path, {"board": "board.yaml"}))
    assert bench.board == Chessboard(5.0, 2.0, scale=PRINTED.scale, scale_sigma=PRINTED.scale_sigma)
    same = load_bench(bench_with(tmp_path / "same", {"board": "board.yaml"}))
    measured = PRINTED.model_copy(update={"measured_mm": [190.0, 280.0]})
    other = load_bench(bench_with(tmp_path / "other", {"board": "board.yaml"}, measured))
    assert bench.content_hash() == same.content_hash() != other.content_hash()


@pytest.mark.parametrize(
    ("target", "printed", "words"),
    [
        ({"board": "none.yaml"}, None, r"none\.yaml"),
        ({"board": "board.yaml", "square_mm": 5.0}, PRINTED, "remove square_mm"),
        ({"board": "board.yaml"}, PRINTED.model_copy(update={"square_mm": None}), "needs square_mm"),
        (
            {"board": "board.yaml"},
            PrintedBoard(kind="particles", particles=9, particle_mm=0.1, seed=1, size_mm=[9.0, 9.0]),
            "kind particles",
        ),
    ],
)
def test_a_wrong_board_file_is_told_with_the_bench(tmp_path, target, printed, words):
    with pytest.raises(ConfigError, match=words):
        load_bench(bench_with(tmp_path, target, printed))


SOME = {"square_mm": 5.0, "squares": [20, 14], "origin_corner": [3, 4]}
PLAIN = PrintedBoard(kind="chessboard", **SOME)
CHARUCO = PrintedBoard(kind="charuco", marker_mm=3.5, dictionary="DICT_4X4_1000", **SOME)


DOTS = PrintedBoard(
    kind="dots",
    pitch_mm=5.0,
    dot_mm=2.0,
    large_dot_mm=3.2,
    bright_dots=True,
    squares=[20, 14],
    origin_corner=[3, 4],
)  # fmt: skip


PLATE = PrintedBoard(**DOTS.model_dump(exclude_none=True), levels="columns", step_mm=1.0, step_sigma_mm=0.02)


@pytest.mark.parametrize(
    ("printed", "kind"), [(PLAIN, Print), (CHARUCO, CodedBoard), (DOTS, DotGrid), (PLATE, Plate)]
)
def test_the_simulated_bench_prints_the_board_of_its_file(tmp_path, printed, kind):
    told = load_bench(bench_with(tmp_path, {"board": "board.yaml"}, printed)).board
    bench = SimulatedBench(load_bench(bench_with(tmp_path, {"board": "board.yaml"}, printed)), "chessboard")
    try:
        paper = bench.world.print
        assert isinstance(paper, kind)
        assert (paper.squares, paper.origin_corner) == ((20, 14), (3, 4))
        assert paper.discs == (LARGE_DOTS if kind in (DotGrid, Plate) else ())
        if kind is Plate:  # as well as its maker knows
            assert 0.0 < abs(paper.dots.step_mm - 1.0) < 0.08
            assert paper.dots.levels == "columns"
        places = np.random.default_rng(2).uniform(-20.0, 60.0, (4000, 2))
        shade = replace(told, scale=paper.scale, odd_bright=told.odd_bright if paper.codes else paper.odd_bright)
        assert np.mean((paper.reflectance(places) > 0.5) == (shade.shade(places) > 0.5)) > 0.999
    finally:
        bench.close()


def test_the_simulated_print_is_not_quite_as_large_as_it_was_measured(tmp_path):
    def board(read_sigma_mm):
        told = PRINTED.model_copy(update={"read_sigma_mm": read_sigma_mm})
        bench = SimulatedBench(load_bench(bench_with(tmp_path, {"board": "board.yaml"}, told)), "chessboard")
        try:
            return np.array(bench.world.print.scale)
        finally:
            bench.close()

    exact, doubted = board(1e-9), board(0.1)
    assert exact == pytest.approx(PRINTED.scale, abs=1e-9)
    off = (doubted - PRINTED.scale) / PRINTED.scale_sigma
    assert (np.abs(off) > 1e-3).all()
    assert (np.abs(off) < 4.0).all()
    assert np.array_equal(doubted, board(0.1))
