"""The chapters that doubt a mean: a step put in at the rim is found, a sound jet is let through."""

import re

import numpy as np
import pytest

from correction.evaluate.regions import Region, Regions
from piv.correlation.vector_field import VectorFlag
from rtpiv.analysis.pairs.pair_vectors import ChunkContent, SeriesField
from rtpiv.analysis.report.flow import checks_of, profile_chapter, rim_chapter
from rtpiv.analysis.report.high_place import high_place
from rtpiv.analysis.report.mean import mean_lead
from rtpiv.analysis.report.page import Page
from rtpiv.analysis.series.history import history
from rtpiv.analysis.series.mean_flow import mean_flow
from tracer.scene.scene_file import load_scene

PX_PER_MM, DT_S, PAIRS = 12.4, 500e-6, 48
SCENE = """\
wavelength_nm: 532.0
camera: {focal_px: 6000.0, sensor_px: [640, 640], position_mm: [0.0, 0.0, 500.0]}
bodies:
  - {name: ball, kind: sphere, centre_mm: [0.0, 0.0, 12.0], radius_mm: 12.0, material: N-BK7}
"""
SIDE = np.linspace(-24.0, 24.0, 39)
X, Y = np.meshgrid(SIDE, SIDE)


def series(step_px=(0.0, 0.0), whole=False, bodies=True):
    """Mean, history and regions of a jet with noise; `whole`: displacements are whole pixels."""
    scale = 1e3 * DT_S * PX_PER_MM
    jet = 8.0 * np.exp(-(X**2) / 100.0) + 0.7
    radius = np.hypot(X, Y) / 12.0
    region = np.where(radius < 0.9, Region.GLASS, np.where(radius > 1.12, Region.DIRECT, Region.RIM)).astype(
        np.uint8
    )
    if not bodies:
        region[:] = Region.DIRECT
    rng, fields = np.random.default_rng(6), []
    for number in range(PAIRS):
        shift = np.stack((0.0 * jet, jet), axis=-1) + rng.normal(0.0, 0.1, (*X.shape, 2))
        shift += (region == Region.GLASS)[..., None] * np.asarray(step_px)
        shift += rng.normal(0.0, 0.6, (1, 1, 2))
        shift = np.rint(shift) if whole else shift
        flags = np.full(X.shape, VectorFlag.VALID, np.uint8)
        flags[0, :5] = VectorFlag.MASKED
        sigma = np.full((*X.shape, 2), 0.1 / scale)
        failure = "a failed flash" if number == 7 else ""
        fields.append(
            SeriesField(
                tag=f"flow-{number}",
                time_s=0.1 * number,
                dt_s=DT_S,
                dt_sigma_s=np.nan,
                velocity_m_s=shift / scale,
                sigma_m_s=sigma,
                resolution_m_s=np.zeros(X.shape),
                steady_m_s=np.zeros(X.shape),
                displacement_px=shift,
                flags=flags,
                correlation=np.ones(X.shape),
                static_share=0.0,
                failure=failure,
            )
        )
    chunks = [ChunkContent(SIDE, SIDE, PX_PER_MM, 32, 16, tuple(fields[k : k + 16])) for k in range(0, PAIRS, 16)]
    mean = mean_flow(chunks)
    return mean, history(chunks, mean), Regions(region, np.where(region == Region.DIRECT, np.nan, radius))


def page_of(path, only_rim=True, **kinds):
    mean, found, regions = series(**kinds)
    (path / "scene.yaml").write_text(SCENE)
    scene = load_scene(path / "scene.yaml")
    page = Page("flow", "test")
    if only_rim:
        rim_chapter(page, mean, scene if kinds.get("bodies", True) else scene.with_bodies(()), regions)
    else:
        profile_chapter(page, mean, regions, bool(scene.bodies))
        checks_of(page, mean, found, scene, regions)
    page.write(path / "flow.html")
    text = re.sub(r"<img[^>]*>", "", (path / "flow.html").read_text())
    return re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", text)), mean, found


def rim_row(text):
    row = re.search(r"0\.0, 0\.0 (\d+) ([+-][\d.]+), ([+-][\d.]+) [\d.]+, [\d.]+ ([\d.]+) (\d+) %", text)
    assert row is not None
    return [float(cell) for cell in row.groups()]


@pytest.mark.slow
@pytest.mark.draws
def test_a_step_at_the_rim_is_found_and_none_is_made_up(tmp_path):
    text, _, _ = page_of(tmp_path)
    pieces, right, up, sigma, covered = rim_row(text)
    assert pieces >= 20
    assert max(abs(right), abs(up)) < 0.05
    assert covered > 50
    text, _, _ = page_of(tmp_path, only_rim=False, step_px=(0.3, -0.2))
    pieces, right, up, sigma, covered = rim_row(text)
    assert [right, up] == pytest.approx([0.3, -0.2], abs=0.05)
    assert sigma < 0.2  # 47 pairs of a flow that jumps by 0.6 px
    for chapter in (
        "Profiles across the flow",
        "Streamlines of the mean",
        "Reynolds stresses",
        "Divergence",
    ):
        assert chapter in text
    assert "Peak locking" in text
    assert "jet&#x27;s axis passes" in text or "jet's axis passes" in text
    for name in ("profiles_v", "profiles_u", "rim", "convergence", "fractions", "divergence"):
        assert (tmp_path / f"{name}.svg").stat().st_size > 2000
    for name in ("streamlines", "stresses"):
        assert (tmp_path / f"{name}.png").stat().st_size > 5000


def test_peak_locking_is_found_and_even_fractions_are_not():
    mean, found, _ = series(whole=True)
    assert found.locking == pytest.approx(1.0)
    even = series()[1]
    assert abs(even.locking) < 0.1
    assert mean.used == PAIRS - 1


def test_the_mean_comes_near_itself_as_independent_pairs_do():
    _, found, _ = series()
    assert found.pairs.tolist() == [1, 2, 4, 8, 16, 32]
    assert np.all(np.diff(found.expected_px) < 0)
    assert found.off_px == pytest.approx(found.expected_px, rel=1.2)  # all places share one jump a pair


def test_without_glass_there_is_no_rim_to_judge(tmp_path):
    text, _, _ = page_of(tmp_path, bodies=False)
    assert "Nowhere do vectors seen directly and through glass lie near enough" in text


def test_the_uncertainty_at_the_head_and_its_parts_are_of_one_and_the_same_vector():
    """The parts add up, as squares, to what stands behind the number, and are no medians of other vectors."""
    mean, _, regions = series()
    value, table = mean_lead(mean, regions)
    size, sigma = (float(word) for word in value.removesuffix(" m/s").split(" ± "))
    behind = regions.region == Region.GLASS
    speed = np.where(behind, np.linalg.norm(mean.mean_m_s, axis=-1), 0.0)
    assert size == pytest.approx(np.quantile(speed[behind & (mean.count > 0)], 0.99), abs=sigma)
    parts = {name: numbers for name, *numbers in table.rows}
    total, *_ = (float(number) for number in parts.pop("total"))
    assert total == pytest.approx(sigma, rel=0.06)
    known = [float(number) for number, *_ in parts.values() if number[0].isdigit()]
    assert np.linalg.norm(known) == pytest.approx(total, rel=0.1)
    assert "median" not in table.title


@pytest.mark.parametrize("lone", [(0, 5), (19, 29), (7, 0)])
@pytest.mark.parametrize("shape", [(20, 30), (60, 80)])
def test_a_single_vector_at_the_border_is_no_headline(lone, shape):
    """One that is alone, and one with neighbours that is far above them."""
    rng = np.random.default_rng(2)
    where = np.zeros(shape, bool)
    where[2:-2, 2:-2] = True
    speed = rng.uniform(0.3, 0.763, shape)
    where[lone], speed[lone] = True, 1.014
    speed[10, 10] = 1.5
    row, column = high_place(speed, where)
    assert where[row, column]
    assert 0.7 < speed[row, column] <= 0.763


def test_the_only_vectors_are_a_headline_all_the_same():
    where = np.zeros((4, 5), bool)
    where[1, 1] = True
    assert high_place(np.ones((4, 5)), where) == (1, 1)
