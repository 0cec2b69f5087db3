"""Moments against exact sums in 50 digits: gaps, few vectors, huge means, any order, any chunks, any damage."""

import mpmath
import numpy as np
import pytest

from piv.errors import SeriesError
from piv.statistics.merge_tree import MergeTree, chunks_of, merge_in_order
from piv.statistics.moments import Moments

SHAPE = (3, 4)


def series(count, offset=0.0, scale=1.0, seed=1):
    """Skewed, correlated vectors with gaps; the first column is never valid, the second once, the third twice."""
    rng = np.random.default_rng(seed)
    fields = []
    for number in range(count):
        u = rng.gamma(2.0, size=SHAPE)
        v = 0.5 * u + rng.normal(size=SHAPE)
        valid = rng.uniform(size=SHAPE) < 0.8
        valid[:, 0], valid[:, 1], valid[:, 2] = False, number == count // 3, number in (1, count - 1)
        vectors = offset + scale * np.stack((u, v), axis=-1)
        vectors[~valid] = rng.choice([np.nan, np.inf, 1e300, 7.0])
        sigma = scale * rng.uniform(0.1, 0.3, (*SHAPE, 2))
        sigma[rng.uniform(size=SHAPE) < 0.2, 0] = np.nan
        fields.append((vectors, valid, sigma))
    return fields


def exact(fields, j, i):
    """Mean, S_uu, S_vv, S_uv, T_u, T_v, skewness of one vector in 50 digits."""
    mpmath.mp.dps = 50
    kept = [(mpmath.mpf(f[j, i, 0]), mpmath.mpf(f[j, i, 1])) for f, valid, _ in fields if valid[j, i]]
    n = len(kept)
    mean = [sum(x[k] for x in kept) / n for k in range(2)]
    d = [[x[k] - mean[k] for x in kept] for k in range(2)]
    second = [sum(a * a for a in d[0]), sum(a * a for a in d[1]), sum(a * b for a, b in zip(*d, strict=True))]
    third = [sum(a**3 for a in d[k]) for k in range(2)]
    return n, mean, second, third


def as_tree(fields, order=None):
    tree = MergeTree()
    for number in order if order is not None else range(len(fields)):
        tree.add(number, Moments.of(*fields[number]))
    return tree.result()


@pytest.mark.parametrize(("offset", "scale"), [(0.0, 1.0), (1e6, 1e-3), (-3.0, 1e4)])
@pytest.mark.parametrize("one_by_one", [True, False])
def test_moments_are_those_of_exact_sums(offset, scale, one_by_one):
    fields = series(101, offset, scale)
    if one_by_one:
        found = Moments.nothing(SHAPE)
        for field in fields:
            found = found.add(*field)
    else:
        found = as_tree(fields)
    assert (found.count[:, 0] == 0).all()
    assert (found.count[:, 1] == 1).all()
    assert (found.count[:, 2] == 2).all()
    for j in range(SHAPE[0]):
        for i in range(1, SHAPE[1]):
            n, mean, second, third = exact(fields, j, i)
            assert found.count[j, i] == n
            for k in range(2):
                error = abs(mpmath.mpf(found.mean[j, i, k]) + mpmath.mpf(found.mean_rest[j, i, k]) - mean[k])
                assert error < 1e-12 * scale
            for k in range(3):
                size = max(second[min(k, 2)], 1e-300) if k < 2 else mpmath.sqrt(second[0] * second[1]) + 1e-300
                assert abs(found.second[j, i, k] - second[k]) <= 1e-12 * size
            for k in range(2):
                assert abs(found.third[j, i, k] - third[k]) <= 1e-12 * n * mpmath.sqrt(second[k] / n) ** 3 + 1e-300


def test_what_is_read_from_moments():
    fields = series(400)
    found = as_tree(fields)
    u = np.array([f[2, 3, 0] for f, valid, _ in fields if valid[2, 3]])
    v = np.array([f[2, 3, 1] for f, valid, _ in fields if valid[2, 3]])
    assert found.mean_uv[2, 3] == pytest.approx([u.mean(), v.mean()], rel=1e-13)
    cov = np.cov(u, v)
    assert found.covariance[2, 3] == pytest.approx([cov[0, 0], cov[1, 1], cov[0, 1]], rel=1e-12)
    told = [s[2, 3] ** 2 for _, valid, s in fields if valid[2, 3] and np.isfinite(s[2, 3]).all()]
    noise = np.mean(told, axis=0)
    assert found.noise[2, 3] == pytest.approx(noise, rel=1e-13)
    assert found.reynolds_stresses[2, 3] == pytest.approx(
        [cov[0, 0] - noise[0], cov[1, 1] - noise[1], cov[0, 1]], rel=1e-12
    )
    assert found.skewness[2, 3, 0] == pytest.approx(((u - u.mean()) ** 3).mean() / u.std() ** 3, rel=1e-12)
    assert 0.7 < found.skewness[2, 3, 0] < 2.2  # a gamma distribution of shape 2 has sqrt(2)
    assert found.lowest[2, 3].tolist() == [u.min(), v.min()]
    assert found.highest[2, 3].tolist() == [u.max(), v.max()]


def test_few_vectors_say_what_they_do_not_know():
    found = as_tree(series(30))
    assert np.isnan(found.mean_uv[:, 0]).all()
    assert np.isnan(found.covariance[:, :2]).all()
    assert np.isfinite(found.mean_uv[:, 1:]).all()
    assert np.isfinite(found.covariance[:, 2:]).all()
    assert np.isnan(found.skewness[:, :3]).all()
    assert np.isnan(Moments.of(np.zeros((*SHAPE, 2))).noise).all()


def bits(moments):
    return {name: values.tobytes() for name, values in moments.to_arrays().items()}


def test_bits_do_not_depend_on_order_or_on_chunks():
    fields = series(100, 3.3)
    whole = bits(as_tree(fields))
    rng = np.random.default_rng(7)
    for _ in range(5):
        assert bits(as_tree(fields, rng.permutation(100))) == whole
    for chunk in (1, 8, 64, 128):
        tree = MergeTree()
        parts = list(enumerate(chunks_of(100, chunk)))
        for number, pairs in (parts[k] for k in rng.permutation(len(parts))):
            tree.add(number, merge_in_order((pair - pairs.start, Moments.of(*fields[pair])) for pair in pairs))
        assert bits(tree.result()) == whole


def test_missing_parts_and_empty_ones_are_the_same():
    fields = series(37)
    lost = {3, 4, 5, 6, 7, 20, 36}
    tree, gaps = MergeTree(), MergeTree()
    for number, field in enumerate(fields):
        if number not in lost:
            tree.add(number, Moments.of(*field))
        gaps.add(number, Moments.nothing(SHAPE) if number in lost else Moments.of(*field))
    assert bits(tree.result()) == bits(gaps.result())


def test_parts_in_order_hardly_wait():
    tree = MergeTree()
    for number in range(1000):
        tree.add(number, Moments.nothing((1, 1)))
        assert len(tree) <= 10


def test_what_cannot_be_merged_is_refused():
    tree = MergeTree()
    with pytest.raises(SeriesError, match="without a single part"):
        tree.result()
    for number in range(4):
        tree.add(number, Moments.nothing(SHAPE))
    for number in (0, 3, -1):
        with pytest.raises(SeriesError, match="counted twice"):
            tree.add(number, Moments.nothing(SHAPE))
    tree.add(4, Moments.nothing(SHAPE))
    with pytest.raises(SeriesError, match="same windows"):
        tree.add(5, Moments.nothing((4, 3)))
    with pytest.raises(SeriesError, match=r"2\^m"):
        list(chunks_of(10, 100))
    with pytest.raises(SeriesError, match="ny, nx, 2"):
        Moments.of(np.zeros((3, 4)))
    with pytest.raises(SeriesError, match="one grid"):
        Moments.of(np.zeros((3, 4, 2)), np.ones((4, 3), bool))


def test_arrays_lead_back_and_damage_is_found():
    found = as_tree(series(20))
    arrays = found.to_arrays()
    assert bits(Moments.from_arrays(arrays)) == bits(found)
    for name, damaged in (
        ("second", None),
        ("second", arrays["second"][..., :2]),
        ("second", -arrays["second"]),
        ("mean", arrays["mean"] * np.nan),
        ("mean", arrays["mean"].astype(str)),
        ("count", arrays["count"] - 1),
        ("count", arrays["count"].astype(float)),
        ("sigma_count", arrays["sigma_count"] + 1000),
    ):
        wrong = {key: value for key, value in arrays.items() if key != name or damaged is not None}
        if damaged is not None:
            wrong[name] = damaged
        with pytest.raises(SeriesError, match=r"damaged|one grid"):
            Moments.from_arrays(wrong)
