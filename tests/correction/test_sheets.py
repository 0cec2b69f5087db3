"""Sheets by runs against labelling by SciPy; block Newton against the careful one."""

import numpy as np
import pytest
from scipy import ndimage

from correction import inversion
from correction.correction_map import build_correction_map
from correction.kernels.sheets import RUN, join_runs, list_runs
from tests.correction.small_scenes import SCENES, small_scene
from tracer.ray_map import build_ray_map


@pytest.mark.parametrize("seed", range(5))
def test_runs_join_to_the_regions_that_labelling_finds(seed: int) -> None:
    rng = np.random.default_rng(seed)
    kinds = ndimage.zoom(rng.integers(0, 4, (12, 14)), 5, order=0) + (rng.random((60, 70)) < 0.1)
    kinds = np.where(rng.random(kinds.shape) < 0.05, 0, kinds)
    code = (2 * kinds + rng.integers(0, 2, kinds.shape) * (kinds > 0)).astype(np.uint32)
    code[:, [0, -1]] = 0
    kinds = code >> 1
    counts = [(np.diff(row.astype(int), prepend=0) != 0)[row > 0].sum() for row in kinds]
    begin = np.concatenate(([0], np.cumsum(counts)))
    runs, parent = np.full((begin[-1], RUN), -1, np.int64), np.empty(begin[-1], np.int64)
    list_runs(code, 0, len(code), begin, runs)
    join_runs(begin, runs, parent)
    sheet = np.zeros(code.shape, int)
    for (row, first, last, kind), head in zip(runs.tolist(), parent.tolist(), strict=True):
        assert np.all(kinds[row, first:last] == kind)
        assert np.all(sheet[row, first:last] == 0)
        sheet[row, first:last] = head + 1
    assert np.array_equal(sheet > 0, kinds > 0)
    for kind in range(1, 6):
        labels, count = ndimage.label(kinds == kind, np.ones((3, 3)))
        pairs = set(zip(labels[kinds == kind].tolist(), sheet[kinds == kind].tolist(), strict=True))
        assert len(pairs) == count == len({head for _, head in pairs})


@pytest.mark.parametrize("name", SCENES)
def test_nodes_in_blocks_and_one_by_one_agree(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same map with the block Newton switched off: other arithmetic, same views."""
    scene = small_scene(name)
    ray_map = build_ray_map(scene)
    blocks = build_correction_map(scene, ray_map, layers=2)
    monkeypatch.setattr(inversion, "fits_lockstep", lambda _: False)
    single = build_correction_map(scene, ray_map, layers=2)
    assert (blocks.status != single.status).sum() <= 2
    both = np.isfinite(blocks.pixel[..., 0]) & np.isfinite(single.pixel[..., 0]) & (blocks.branch == single.branch)
    assert both.sum() > 0.999 * np.isfinite(single.pixel[..., 0]).sum()
    assert np.abs(blocks.pixel - single.pixel)[both].max() < 1e-7
    assert np.allclose(blocks.jacobian[both], single.jacobian[both], rtol=1e-3, atol=1e-4)
    assert np.allclose(blocks.transmittance[both], single.transmittance[both], rtol=1e-5)


def test_arrays_of_an_earlier_map_are_written_in_full() -> None:
    scene = small_scene("pyramid_500", 200)
    ray_map = build_ray_map(scene)
    fresh, old = (build_correction_map(scene, ray_map, layers=2) for _ in range(2))
    for name in ("status", "pixel", "jacobian", "weight", "transmittance", "branch"):
        getattr(old, name)[...] = 3
    again = build_correction_map(scene, ray_map, layers=2, out=old)
    assert again.pixel is old.pixel
    for name in ("status", "pixel", "jacobian", "weight", "transmittance", "branch"):
        assert np.array_equal(
            getattr(again, name), getattr(fresh, name), equal_nan=name in ("pixel", "jacobian")
        ), name
