"""Small sheets of a bed solved in one call: the bits of solving one after the other, large or small."""

import numpy as np
import pytest

from benchmarks.scenes import bed
from correction.inversion import invert, sheets
from correction.inversion.kernels import bed_sheets as starts
from correction.inversion.kernels.bed_sheets import keep_nearest
from correction.inversion.sheets import _nearest
from correction.maps.correction_map import CorrectionMap, build_correction_map
from tests.tracer.test_beds import mixed_bed, small
from tracer.scene.scene import Scene
from tracer.strategies.ray_map import RayMap, build_ray_map


def bits(made: CorrectionMap) -> list[bytes]:
    return [array.tobytes() for array in made.arrays().values()]


def one_by_one(where: Scene, ray_map: RayMap, layers: int, monkeypatch: pytest.MonkeyPatch) -> CorrectionMap:
    with monkeypatch.context() as patched:
        patched.setattr(
            invert.Inversion,
            "_solve_many",
            lambda self, sheets: [self._solve_one(sheet, sheets) for sheet in sheets],
        )
        return build_correction_map(where, ray_map, layers=layers)


@pytest.mark.parametrize("layers", [1, 3])
def test_same_bits_as_one_by_one(layers: int, monkeypatch: pytest.MonkeyPatch) -> None:
    for where in (small(bed(128), 16.0), mixed_bed(2)):
        ray_map = build_ray_map(where)
        made = build_correction_map(where, ray_map, layers=layers)
        assert bits(made) == bits(one_by_one(where, ray_map, layers, monkeypatch))
        assert made.behind_glass.sum() > 100


@pytest.mark.parametrize("rows", [16, 37])
def test_same_bits_however_nodes_are_shared_by_cores(rows: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Views that cross from one part into the next, and sheets whose edges alone fill a portion of starts."""
    where = small(bed(16), 8.0)
    ray_map = build_ray_map(where)
    expected = bits(one_by_one(where, ray_map, 2, monkeypatch))
    monkeypatch.setenv("RTPIV_THREADS", "2")
    monkeypatch.setattr(invert, "LEAST_ROWS", rows)
    monkeypatch.setattr(invert, "PARTS", 1000)
    assert bits(build_correction_map(where, ray_map, layers=2)) == expected
    monkeypatch.setattr(sheets, "ENOUGH_NODES", 1)  # then two rows of nodes
    assert bits(build_correction_map(where, ray_map, layers=2)) == expected


@pytest.mark.parametrize("place", ["packed", "mixed"])
def test_what_is_given_up_had_no_hope(place: str) -> None:
    """The bits of solving every node with care that a block has not solved."""
    where = small(bed(128), 12.0) if place == "packed" else mixed_bed(4)
    ray_map = build_ray_map(where)
    every = build_correction_map(where, ray_map, layers=2, skip=False)
    assert bits(build_correction_map(where, ray_map, layers=2)) == bits(every)


def test_sheets_of_more_nodes_than_a_portion(monkeypatch: pytest.MonkeyPatch) -> None:
    """A bed of sixteen balls on many pixels: sheets of more nodes than one portion of starts."""
    where = small(bed(16), 2.5)
    ray_map = build_ray_map(where)
    made = build_correction_map(where, ray_map)
    assert max(np.bincount(made.branch[0].ravel())[1:]) > starts.ENOUGH_NODES
    assert bits(made) == bits(one_by_one(where, ray_map, 1, monkeypatch))


def test_the_nearest_start_of_each_node_is_kept() -> None:
    rng = np.random.default_rng(5)
    nodes = rng.integers(0, 12, (400, 2)).astype(np.int32)
    told = np.column_stack((rng.random((400, 2)), rng.integers(0, 9, 400), rng.random(400)))
    told_before, nodes_before, slots = told.copy(), nodes.copy(), np.zeros(1024, np.int64)
    for stamp in (1, 2):
        told[...], nodes[...] = told_before, nodes_before
        kept = keep_nearest(50, 400, stamp, told, nodes, slots)
        wanted = _nearest(told_before[50:], nodes_before[50:])
        order = np.lexsort(nodes[50:kept].T[::-1])
        assert np.array_equal(nodes[50:kept][order], wanted[1])
        assert np.array_equal(told[50:kept][order], wanted[0])
        assert np.array_equal(told[:50], told_before[:50])
