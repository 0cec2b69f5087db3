"""The total error with its parts, and whether a sigma keeps what it claims."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from correction.evaluate.regions import Region, Regions, evaluate_shift
from rtpiv.analysis.pairs.evaluation import Evaluation
from rtpiv.analysis.pairs.pair_vectors import quality_of
from rtpiv.analysis.report.sigma_verdict import claim_said, sigma_verdict, worst_claim
from rtpiv.analysis.report.tables import (
    claim_table,
    coverage_of,
    displacement_table,
    lead_of,
    offset_said,
    sigma_table,
    totals_of,
)
from tests.correction.evaluate.vectors import uniform_field
from tests.loops import loop_over

SHIFT_PX = (4.0, -3.0)


def evaluation(bias=(0.03, -0.01), noise=0.02, sigma=0.02, known=True, glass=True, moved=None, slanted=None):
    rng = np.random.default_rng(4)
    field = uniform_field((640, 640), SHIFT_PX, step_px=16, window_px=16)
    field.sigma_u_px[:], field.sigma_v_px[:] = sigma, sigma
    field.u_px[:] += bias[0] + rng.normal(0.0, noise, field.u_px.shape)
    field.v_px[:] += bias[1] + rng.normal(0.0, noise, field.u_px.shape)
    region = np.full(field.flags.shape, Region.DIRECT, np.uint8)
    region[10:30, 10:30] = Region.GLASS if glass else Region.DIRECT
    regions = Regions(region, np.where(region == Region.GLASS, 0.5, np.nan))
    shift = evaluate_shift(field, regions, SHIFT_PX, (0.05, 0.05)) if known else None
    joined = None
    if moved is not None:
        by_map = np.full((*field.flags.shape, 2), moved)
        joined = SimpleNamespace(displacement_px=by_map, relative_px=by_map.copy())
    slant = None if slanted is None else SimpleNamespace(sigma_px=np.full((*field.flags.shape, 2), slanted))
    task = SimpleNamespace(scene=SimpleNamespace(bodies=("ball",)))
    return Made(task=task, field=field, regions=regions, shift=shift, map_sigma=joined, slant=slant)


class Made(SimpleNamespace):
    """An evaluation that is made of little."""

    sigma_parts_px, total_sigma_px = Evaluation.sigma_parts_px, Evaluation.total_sigma_px
    relative_sigma_px = Evaluation.relative_sigma_px


def test_the_total_is_bias_and_scatter_of_what_lies_behind_glass():
    glass, direct = totals_of(evaluation(moved=0.004))
    assert (glass.region, glass.count, direct.region) == ("behind glass", 400, "seen directly")
    parts = dict(glass.parts)
    for axis, bias in enumerate((0.03, -0.01)):
        assert parts["bias"][axis] == pytest.approx(bias, abs=0.004)
        assert parts["scatter"][axis] == pytest.approx(0.02, rel=0.15)
        assert glass.total_px[axis] == pytest.approx(np.hypot(parts["bias"][axis], parts["scatter"][axis]))
    assert set(parts) == {"bias", "scatter"}  # the map's and the stage's sigma are no parts, and may be larger
    value, table = lead_of(glass)
    assert table.title == "scatter of the errors u, v of the 400 vectors behind glass"
    assert value == "{:.4f}, {:.4f} px".format(*parts["scatter"])
    assert table.rows[0][0] == "common offset"
    assert table.columns == ("[px]", "u", "v")
    assert table.rows[-1][0] == "total (root sum of squares)"
    assert glass.where(evaluation()).sum() == 400 <= glass.nodes(evaluation())


@loop_over("known", [True, False])
@loop_over("moved", [0.3, 0.001, None])
@loop_over("slanted", [0.1, None])
def test_no_part_is_larger_than_its_total(known, moved, slanted):
    for total in totals_of(evaluation(known=known, moved=moved, slanted=slanted)):
        named = "sigma by the flow through the sheet" in dict(total.parts)
        assert named == (slanted is not None and not known)
        for _, part in total.parts:
            assert all(abs(one) <= whole * (1.0 + 1e-9) for one, whole in zip(part, total.total_px, strict=True))
        squares = np.sum(np.square([part for _, part in total.parts]), axis=0)
        assert np.sqrt(squares) == pytest.approx(total.total_px, rel=1e-6)


def test_without_glass_it_is_of_what_is_seen_directly():
    (only,) = totals_of(evaluation(glass=False))
    assert (only.region, only.count) == ("seen directly", 39 * 39)


def test_without_a_known_shift_it_is_an_uncertainty():
    glass, _ = totals_of(evaluation(known=False, moved=0.015))
    assert not glass.is_error
    assert glass.total_px == pytest.approx((0.025, 0.025))
    assert "uncertainty" in glass.label
    assert coverage_of(evaluation(known=False), np.ones((39, 39), bool)) is None


@pytest.mark.parametrize(("sigma", "claim"), [(0.02, "as claimed"), (0.01, "too small"), (0.04, "too large")])
def test_sigma_is_held_to_its_claim(sigma, claim):
    found = coverage_of(evaluation(sigma=sigma), np.ones((39, 39), bool))
    assert found.claim == claim
    assert found.ratio == pytest.approx((0.02 / sigma,) * 2, rel=0.1)
    if claim == "as claimed":
        assert found.within_1 == pytest.approx((0.683, 0.683), abs=0.04)
        assert found.within_2 == pytest.approx((0.954, 0.954), abs=0.02)


def test_ratio_and_claim_are_of_one_number_where_sigma_is_not_everywhere_the_same():
    """A few places whose sigma is far too large do not make that of all too large where errors are 1.1 of it."""
    made = evaluation(sigma=0.017)
    made.field.sigma_u_px[:4], made.field.sigma_v_px[:4] = 0.2, 0.2
    found = coverage_of(made, np.ones((39, 39), bool))
    assert all(ratio > 1.05 for ratio in found.ratio)
    assert found.claim != "too large"


def test_what_the_map_is_unsure_of_counts_for_the_coverage():
    """Errors of which half come from the map: random sigma alone is too small, both together are as claimed."""
    made = evaluation(noise=0.04, sigma=0.024, moved=0.032)
    found = coverage_of(made, np.ones((39, 39), bool))
    assert found.claim == "as claimed"
    assert found.ratio == pytest.approx((1.0, 1.0), rel=0.1)
    made.map_sigma = None
    assert coverage_of(made, np.ones((39, 39), bool)).claim == "too small"


def test_file_page_and_verdict_have_one_sigma():
    """Of a known shift random and map sigma, else what windows do not resolve as well."""
    made = evaluation(noise=0.05, sigma=0.03, moved=0.04)
    made.field = replace(made.field, resolution_px=np.full(made.field.flags.shape, 0.12))
    grid = SimpleNamespace(pitch_mm=0.5)
    made.map_sigma.position_px = np.zeros((39, 39, 2))

    def held():
        return quality_of(made.field, grid, made.total_sigma_px, made.map_sigma)["total_sigma_u"] / grid.pitch_mm

    assert coverage_of(made, np.ones((39, 39), bool)).claim == "as claimed"
    np.testing.assert_allclose(held(), 0.05, rtol=1e-6)
    made.shift = None
    np.testing.assert_allclose(held(), 0.13, rtol=1e-6)
    assert displacement_sigma(made, grid) == pytest.approx([0.13 * grid.pitch_mm] * 2, rel=0.05)
    (glass, _) = totals_of(made)
    assert glass.total_px == pytest.approx((0.13, 0.13))


def displacement_sigma(made, grid):
    """Total sigma in the table of displacements."""
    made.grid, made.task.dt_s = grid, None
    return [float(part) for part in displacement_table(made).rows[0][-1].split(",")]


@pytest.mark.parametrize(
    ("behind", "beside", "said"),
    [
        (0.02, 0.02, "sigma is as claimed in every region"),
        (0.01, 0.04, "sigma is 2 times too small behind glass, r < 0.75 R"),  # right on the average
        (0.04, 0.01, "sigma is 2 times too small seen directly"),
        (0.06, 0.02, "sigma is 3 times too large behind glass, r < 0.75 R"),
        (0.01, 0.005, "sigma is 4 times too small seen directly"),
    ],
)
def test_the_verdict_names_the_worst_region(behind, beside, said):
    made = evaluation()
    glass = made.regions.region == Region.GLASS
    made.field.sigma_u_px[:] = made.field.sigma_v_px[:] = np.where(glass, behind, beside)
    region, found = worst_claim(made)
    words = claim_said(region, found)
    number = [float(word) for word in words.split() if word.replace(".", "").isdigit()]
    wanted = [float(word) for word in said.split() if word.isdigit()]
    if wanted:
        assert number[0] == pytest.approx(wanted[0], rel=0.15)
        assert words.split("times ")[1][:9] == said.split("times ")[1][:9]
        assert words.partition("too ")[2].split()[1:3] == said.partition("too ")[2].split()[1:3]
    else:
        assert words == said


def test_without_a_known_shift_the_verdict_says_that_nothing_is_judged():
    made = evaluation(known=False, sigma=0.03)
    glass = made.regions.region == Region.GLASS
    made.field = replace(made.field, resolution_px=np.where(glass, 0.12, 0.01))
    assert sigma_verdict(made) == (
        "sigma is not judged: the true displacement is not known; it is largest behind glass, r < 0.75 R, 0.12 px,"
        " most of it not resolved by the windows"
    )
    made.field.sigma_u_px[:] = np.nan
    assert sigma_verdict(made) == "sigma is not judged: the true displacement is not known"


def test_an_offset_that_is_the_same_beside_the_glass_is_the_stage():
    assert offset_said(evaluation()) == (
        "Common offset 0.030 px, the same beside the glass: that is the stage (allowed 0.14 px)."
    )
    assert "too much for the stage" in offset_said(evaluation(bias=(0.3, 0.0)))
    assert "of the stage or of the map" in offset_said(evaluation(glass=False))
    assert offset_said(evaluation(known=False)) == ""
    made = evaluation()
    made.field.u_px[made.regions.region == Region.GLASS] += 0.05
    made.shift = evaluate_shift(made.field, made.regions, SHIFT_PX, (0.05, 0.05))
    assert "beside the glass: the map or the scene is off" in offset_said(made)


def test_tables_and_head_have_one_verdict_of_a_region():
    made = evaluation(sigma=0.04)
    claims = {row[0]: row[-1] for row in claim_table(made).rows}
    glass, _ = totals_of(made)
    assert claims[glass.region] == coverage_of(made, glass.where(made)).claim == "too large"


@pytest.mark.parametrize(("dt_s", "unit", "scale"), [(None, "mm", 0.5), (2e-3, "m/s", 0.25)])
def test_without_a_known_shift_what_moved_is_said_beside_and_behind_the_glass(dt_s, unit, scale):
    made = evaluation(known=False, sigma=0.03)
    made.field = replace(made.field, resolution_px=np.full(made.field.flags.shape, 0.04))
    made.field.sigma_u_px[::5, ::5] = 9.0  # a few vectors that noise has taken are not what is usual
    made.grid, made.task.dt_s = SimpleNamespace(pitch_mm=0.5), dt_s
    table = displacement_table(made)
    rows = table.rows
    assert f"[{unit}]" in table.columns[-1]
    assert [row[:2] for row in rows] == [("behind glass", "400"), ("seen directly", "1121")]
    for _, _, px, on_plane, unsure in rows:
        assert [float(part) for part in unsure.split(",")] == pytest.approx([0.05 * scale] * 2, rel=0.05)
        u, v = (float(part) for part in px.split(","))
        assert (u, v) == pytest.approx((4.03, -3.01), abs=0.01)
        assert [float(part) for part in on_plane.split(",")] == pytest.approx((scale * u, -scale * v), abs=1e-3)


def test_an_offset_of_nothing_has_no_sign():
    rows = lead_of(totals_of(evaluation(bias=(-1e-6, -1e-6), noise=0.0))[0])[1].rows
    assert rows[0] == ("common offset", "+0.0000", "+0.0000")


def test_what_windows_do_not_resolve_is_a_part_of_the_total_that_files_hold():
    of = evaluation(known=False, sigma=0.02)
    of.field = replace(of.field, resolution_px=np.full(of.field.flags.shape, 0.03))
    glass, _ = totals_of(of)
    assert dict(glass.parts)["not resolved by the windows"] == pytest.approx((0.03, 0.03))
    assert glass.total_px == pytest.approx((np.hypot(0.02, 0.03),) * 2)
    assert glass.total_px == pytest.approx(tuple(of.field.total_sigma_px[20, 20]))
    row = sigma_table(of).records()[0]
    assert row["not resolved u, v"] == "0.030, 0.030"
