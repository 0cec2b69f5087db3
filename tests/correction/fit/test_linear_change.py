"""The difference of two scenes as one change: derivatives of the map say with it what the two maps differ by."""

from dataclasses import replace

import numpy as np
import pytest

from correction.fit.solve.linear_change import as_linear
from correction.fit.solve.solver import Corners, free_rates, land_corners
from correction.fit.solve.unknowns import unknowns_of
from correction.grid import PlaneGrid, grid_of
from correction.maps.correction_map import build_correction_map
from sim.demo.scenes import at_size, demo_scene, misalign
from tests.correction.fit.drawn_labs import drawn_lab
from tracer.scene.fit_section import FitTable
from tracer.strategies.ray_map import build_ray_map

LIFTED_MM = 1.6
OF_A_DIFFERENCE = 0.02  # how exactly derivatives can say it, at nine nodes of ten


@pytest.mark.parametrize("name", ["pair_off_axis", "two_spheres_500", "three_spheres_500"])
@pytest.mark.parametrize("seed", [1, 2])
def test_derivatives_say_the_difference_where_the_map_shows_anything(name, seed):
    """A lifted ball: pixels at its rim, where derivatives say hundreds of px, must not have the say everywhere."""
    scene = misalign(at_size(demo_scene(name), 1008), seed)
    unknowns = unknowns_of(scene, [0.0], FitTable())
    full = unknowns.start
    other = full.copy()
    other[unknowns.full_names.index(f"{scene.spheres[-1].name}.z")] += LIFTED_MM
    grid = grid_of(scene.camera)
    coarse = PlaneGrid(grid.origin_mm, 8 * grid.pitch_mm, (grid.shape[0] // 8, grid.shape[1] // 8))
    shown = build_correction_map(scene, build_ray_map(scene), coarse, min_magnification=4.0, max_magnification=128)
    pixels = shown.pixel[0][shown.behind_glass].astype(float)
    asked = Corners(0, True, pixels, np.zeros_like(pixels), 1.0)
    before, after = land_corners(unknowns, full, asked), land_corners(unknowns, other, asked)
    same = before.recovered & after.recovered & (before.key == after.key)
    truly = (after.point_mm - before.point_mm)[same]
    every = replace(unknowns, columns=np.eye(len(full)), names=unknowns.full_names)
    added, (_, unsaid_px) = as_linear(unknowns, full, other, unknowns.columns)
    change = other - full + added
    said = free_rates(every, full, asked, before)[same] @ change
    size = np.linalg.norm(truly, axis=1)
    off = np.linalg.norm(said - truly, axis=1) / (size + np.median(size))
    print(f"\n{name}: {np.median(size) / grid.pitch_mm:.2f} px, off {np.quantile(off, [0.5, 0.9])}")
    assert np.count_nonzero(same) > 100
    assert np.quantile(off, 0.9) < OF_A_DIFFERENCE
    left = np.linalg.solve(before.pixel_rate[same], (said - truly)[:, :, None])[:, :, 0]
    assert 0.3 < np.sqrt(np.median(np.sum(left**2, axis=1)) / 1.386) / unsaid_px < 3.0


@pytest.mark.parametrize(
    ("seed", "fault"), [(131016, "ball off"), pytest.param(101014, "ellipsoid", marks=pytest.mark.slow)]
)
def test_sigma_of_a_named_fault_is_the_error_at_every_node(seed, fault):
    """Sigma was 0.02 px where the map was 1.15 px off along x, and 0.001 px where it was 0.05 px off along y."""
    lab = drawn_lab(seed, fault, pulled=float(np.random.default_rng((18, seed)).normal()))
    assert fault == "ellipsoid" or "does not stand where it was held" in lab.fit.verdict.sentences[0]
    chi = np.abs(lab.error_px / lab.sigma_px)
    assert 0.7 < np.sqrt(np.mean(chi**2)) < 1.3
    assert chi.max() < 4.0
