"""Which route is better where, and one field of the better ones."""

from dataclasses import replace

import numpy as np
import pytest

from correction.evaluate.carried_vectors import PlaneVectors
from correction.evaluate.regions import Region, regions_of
from correction.evaluate.routes import compare_routes, joined
from correction.maps.correction_map import build_correction_map
from piv.correlation.vector_field import VectorFlag
from tests.correction.evaluate.vectors import uniform_field
from tests.correction.small_scenes import small_scene
from tracer.strategies.ray_map import build_ray_map

SHIFT_PX = (3.0, -2.0)


@pytest.fixture(scope="module")
def made():
    """A field that errs by 0.3 px behind the glass, and traced vectors that err by 0.02 px everywhere."""
    scene = small_scene("two_spheres_500", 252)
    cmap = build_correction_map(scene, build_ray_map(scene))
    field = uniform_field(cmap.grid.shape, SHIFT_PX, step_px=6, window_px=12)
    regions = regions_of(field, cmap, scene)
    field = replace(field, u_px=field.u_px + np.where(regions.region == Region.GLASS, 0.3, 0.001))
    some = (regions.region == Region.DIRECT) | (regions.region == Region.GLASS)
    nodes = field.grid_px[some] + 1.0
    pitch = cmap.grid.pitch_mm
    shift = np.tile((SHIFT_PX[0] + 0.02, -SHIFT_PX[1]), (len(nodes), 1)) * pitch
    row, column = np.clip(np.rint(nodes[:, ::-1]).astype(int), 0, 251).T
    branch = cmap.branch[0][row, column]
    traced = PlaneVectors(cmap.grid.to_mm(nodes), shift, np.full_like(shift, 0.02 * pitch), nodes, branch)
    return field, regions, traced, cmap, scene


def test_each_region_takes_its_better_route(made):
    field, regions, traced, cmap, _ = made
    routes = compare_routes(*made, SHIFT_PX)
    rows = [row for row in routes.rows() if not row[0].startswith("1.")]
    verdicts = {name: better for name, _, two, better in rows if two.count >= 4}
    assert verdicts.pop("seen directly") == "image"
    assert len(verdicts) > 5
    assert set(verdicts.values()) == {"velocity"}
    assert {better for *_, two, better in rows if two.count < 4} <= {"equal"}  # one window alone decides nothing
    assert routes.direct[0].rms_px == pytest.approx(0.001 / np.sqrt(2), rel=1e-3)
    both, by_velocity = joined(field, regions, traced, cmap, routes)
    glass = regions.region == Region.GLASS
    assert by_velocity[regions.region == Region.DIRECT].sum() == 0
    assert by_velocity[glass].mean() > 0.85  # the others lie beside the outermost traced vectors
    assert np.allclose(both.u_px[by_velocity], SHIFT_PX[0] + 0.02, atol=1e-9)
    assert np.allclose(both.v_px[by_velocity], SHIFT_PX[1], atol=1e-9)
    assert np.allclose(both.sigma_u_px[by_velocity], 0.02)
    assert np.isnan(both.correlation[by_velocity]).all()
    assert np.array_equal(both.u_px[~by_velocity], field.u_px[~by_velocity])
    assert (both.flags[by_velocity] == VectorFlag.VALID).all()


def test_without_a_known_shift_their_own_sigma_decides(made):
    field, *rest = made
    sharp = replace(field, sigma_u_px=0.03 * field.u_px / field.u_px, sigma_v_px=field.sigma_v_px)
    routes = compare_routes(sharp, *rest, None)
    assert not routes.known
    assert {better for *_, two, better in routes.rows() if two is not None} == {
        "velocity"
    }  # 0.02, 0.02 against 0.03, 0.01


def test_a_route_that_found_nothing_is_never_better(made):
    field, regions, traced, cmap, scene = made
    empty = PlaneVectors(*(column[:0] for column in vars(traced).values()))
    routes = compare_routes(field, regions, empty, cmap, scene, SHIFT_PX)
    assert {better for *_, better in routes.rows()} == {"image"}
    assert not joined(field, regions, empty, cmap, routes)[1].any()
