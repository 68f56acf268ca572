"""Large matrices in a band, and determinants of blocks, beside what numpy gives for the dense matrix."""

from __future__ import annotations

import numpy as np
import pytest

import robodyn
from robodyn_cli.algorithms import bands
from robodyn_cli.algorithms.constraints import determinant
from robodyn_cli.solve import guided

SHAPES = [(130, 130), (130, 131), (200, 150), (150, 200)]


def in_a_band(m: int, n: int, rng: np.random.Generator, samples: int = 3, lost: int = 0) -> np.ndarray:
    """Return matrices with entries about the diagonal; lost : rows that repeat others."""
    A = np.zeros((samples, m, n))
    for i in range(m):
        first = min(max(int(i * n / m) - 1, 0), n - 3)
        A[:, i, first : first + 3] = rng.normal(size=(samples, 3))
    A[:, 1 : 1 + lost] = 2.0 * A[:, :1]
    return A


def banded(m: int, n: int, seed: int, samples: int = 3, lost: int = 0) -> np.ndarray:
    """Return the same with rows and columns shuffled."""
    rng = np.random.default_rng(seed)
    A = in_a_band(m, n, rng, samples, lost)
    return A[:, rng.permutation(m)][:, :, rng.permutation(n)]


@pytest.mark.parametrize("lost", [0, 1])
@pytest.mark.parametrize("shape", SHAPES)
def test_singular_values_of_a_band_are_those_of_the_dense_matrix(shape, lost):
    A = banded(*shape, seed=sum(shape), lost=lost)
    assert bands.Band.of(A) is not None
    dense = np.linalg.svd(A, compute_uv=False)
    np.testing.assert_allclose(bands.singular_values(A), dense, rtol=0, atol=1e-13 * dense.max())
    np.testing.assert_array_equal(bands.singular_values(A[0]), bands.singular_values(A)[0])


@pytest.mark.parametrize("shape", SHAPES)
def test_an_order_that_is_narrow_as_given_is_taken(shape, monkeypatch):
    A = in_a_band(*shape, np.random.default_rng(sum(shape)))
    looked, own = [], bands._orders
    monkeypatch.setattr(bands, "_orders", lambda *args: looked.append(args) or own(*args))
    band = bands.Band.of(A)
    assert band is not None and not looked and band.width <= 6
    dense = np.linalg.svd(A, compute_uv=False)
    np.testing.assert_allclose(bands.singular_values(A), dense, rtol=0, atol=1e-13 * dense.max())
    shuffled = banded(*shape, seed=sum(shape))
    assert bands.Band.of(shuffled).width < 12 and len(looked) == 1


@pytest.mark.parametrize("seed", range(4))
def test_a_band_is_eliminated_as_the_dense_matrix_is(seed):
    A, b = banded(131, 131, seed), np.random.default_rng(seed).normal(size=(3, 131))
    A[:, np.arange(131), np.argmax(A[0] != 0.0, axis=1)] += 3.0
    x = bands.solved(A, b)
    np.testing.assert_allclose((A @ x[..., None])[..., 0], b, rtol=0, atol=1e-10 * max(1.0, np.abs(x).max()))
    for own, dense in zip(bands.slogdet(A), np.linalg.slogdet(A)):
        np.testing.assert_allclose(own, dense, rtol=1e-10)
    np.testing.assert_allclose(bands.determinants(A), np.linalg.det(A), rtol=1e-8)


def test_what_has_no_narrow_band_is_left_to_numpy_and_what_is_singular_or_not_finite_is_refused():
    A = np.random.default_rng(0).normal(size=(2, 80, 80))
    assert bands.Band.of(A) is None
    np.testing.assert_array_equal(bands.singular_values(A), np.linalg.svd(A, compute_uv=False))
    singular = banded(130, 130, seed=1)
    singular[:, 7] = 0.0
    assert not bands.slogdet(singular)[0].any()
    with pytest.raises(np.linalg.LinAlgError):
        bands.solved(singular, np.ones((3, 130)))
    singular[0, 5, np.flatnonzero(singular[0, 5])[0]] = np.nan
    with pytest.raises(np.linalg.LinAlgError):
        bands.singular_values(singular)


@pytest.mark.parametrize("shape", [(130, 130), (140, 120), (120, 140)])
@pytest.mark.parametrize("ratio", [1e-8, 1e-4, 0.5])
def test_full_rank_is_told_as_by_singular_values_which_few_matrices_need(shape, ratio, monkeypatch):
    A = banded(*shape, seed=sum(shape), samples=8)
    for k, small in enumerate((0.0, 1e-14, 1e-9, 1e-7, 1e-3)):
        A[k, :, 5] *= small
    A[6] *= 1e-170
    A[7] *= 1e170
    sigma, asked, own = np.linalg.svd(A, compute_uv=False), [], bands.singular_values
    monkeypatch.setattr(bands, "singular_values", lambda A: asked.append(len(A)) or own(A))
    full = bands.full_rank(A, ratio)
    np.testing.assert_array_equal(full, sigma[:, -1] > ratio * sigma[:, 0])
    if shape[0] >= shape[1] and ratio == 1e-8:
        assert full[4:].all() and not full[:2].any()
        assert sum(asked) <= 4, "none is found of those that are far from singular"
    A[0, :, 3] = np.nan
    with pytest.raises(np.linalg.LinAlgError):
        bands.full_rank(A, ratio)


@pytest.mark.parametrize("shape", [(130, 130), (140, 120)])
def test_small_rows_take_no_singular_values(shape, monkeypatch):
    """Rows of a long mechanism's loops are small beside that of what leads it, which takes nothing from the rank."""
    (m, n), rng = shape, np.random.default_rng(2)
    far = np.abs(np.arange(m)[:, None] * n // m - np.arange(n))
    A = np.where(far < 2, rng.normal(size=(3, m, n)), 0.0) + 9.0 * (far == 0)
    A = A[:, rng.permutation(m)][:, :, rng.permutation(n)]
    A[:, 1:] *= 1e-6
    A[1, :, 5] = 0.0
    A[2, :, 7] *= 1e-9
    sigma, asked, own = np.linalg.svd(A, compute_uv=False), [], bands.singular_values
    monkeypatch.setattr(bands, "singular_values", lambda A: asked.append(len(A)) or own(A))
    wanted = sigma[:, -1] > 1e-11 * sigma[:, 0]
    assert wanted[0] and sigma[0, -1] < bands.SURE * sigma[0, 0] and not wanted[1]
    np.testing.assert_array_equal(bands.full_rank(A, 1e-11), wanted)
    assert sum(asked) == np.count_nonzero(~wanted)


@pytest.mark.parametrize("shape", [(130, 131), (131, 130)])
def test_matrices_by_their_entries_give_what_arrays_do(shape, monkeypatch):
    A = banded(*shape, seed=4)
    rows, columns = np.nonzero((A != 0.0).any(axis=0))
    scattered = bands.Scattered(A[:, rows, columns], rows, columns, shape)
    some = [k for k in range(shape[1]) if k % 40][::-1]
    square = list(range(1, 131)) if shape[0] == 130 else []
    pairs = [(scattered, A), (scattered.of_columns(some), A[:, :, some])]
    for _ in range(2):
        for own, array in pairs:
            dense = np.linalg.svd(array, compute_uv=False)
            np.testing.assert_allclose(bands.singular_values(own), dense, rtol=0, atol=1e-13 * dense.max())
        if square:
            wanted = np.linalg.det(A[:, :, square])
            np.testing.assert_allclose(bands.determinants(scattered.of_columns(square)), wanted, rtol=1e-8)
        # the same without a band, an array of few samples at a time
        monkeypatch.setattr(bands, "AT_A_TIME", 1)
        monkeypatch.setattr(bands.Band, "of", staticmethod(lambda A: None))


@pytest.mark.parametrize("seed", range(4))
def test_a_determinant_is_the_product_of_those_of_its_blocks(seed):
    rng = np.random.default_rng(seed)
    sizes = rng.integers(1, 5, 12)
    ends = np.cumsum(sizes)
    A = np.zeros((ends[-1], ends[-1]))
    for end, size in zip(ends, sizes):
        A[end - size : end, end - size : end] = rng.normal(size=(size, size))
        A[end - size : end, : end - size] = np.where(rng.uniform(size=(size, end - size)) < 0.1, 1.0, 0.0)
    A = A[rng.permutation(len(A))][:, rng.permutation(len(A))]
    assert float(determinant(A.astype(object))) == pytest.approx(np.linalg.det(A), rel=1e-9)
    A[3] = 0.0
    assert determinant(A.astype(object)) == 0.0


def windows(n: int) -> str:
    """Return the kinematics of n windows side by side, whose legs of 1 m stand 1 m apart."""
    joints, links, loops, q = [], [], [], []
    for k in range(n + 1):
        joints.append(
            f"{{name: leg{k}, type: revolute, axis: [0, 0, 1], parent: base, link: L{k}, origin: {{xyz: [{k}, 0, 0]}}}}"
        )
        links.append(f"{{name: L{k}}}")
        q.append(f"leg{k}: 70 deg")
    for k in range(n):
        joints.append(
            f"{{name: bar{k}, type: revolute, axis: [0, 0, 1], parent: L{k}, link: C{k}, origin: {{xyz: [1, 0, 0]}}}}"
        )
        links.append(f"{{name: C{k}}}")
        q.append(f"bar{k}: -70 deg")
        loops.append(f"{{name: window{k}, type: revolute, between: [R{k}, T{k + 1}]}}")
    points = [f"T{k}: {{link: L{k}, at: [1, 0, 0]}}" for k in range(n + 1)]
    points += [f"R{k}: {{link: C{k}, at: [1, 0, 0]}}" for k in range(n)]
    return "\n".join([
        "schema: 1", "gravity: [0, -9.81, 0]", "robot:",
        f"  joints: [{', '.join(joints)}]", f"  links: [{', '.join(links)}]",
        f"  points: {{{', '.join(points)}}}", f"loops: [{', '.join(loops)}]",
        f"initial: {{q: {{{', '.join(q)}}}, hold: [leg0]}}",
        "kinematics: {sweep: {joint: leg0, start: 70 deg, stop: 100 deg, rate: 1}, samples: 11}", "",
    ])  # fmt: skip


def test_the_kinematics_of_many_loops_are_those_of_dense_matrices(tmp_path, monkeypatch):
    scene = tmp_path / "scene.yaml"
    scene.write_text(windows(46))
    own = robodyn.kinematics(scene)
    found = []
    monkeypatch.setattr(bands, "AT_A_TIME", 1)
    monkeypatch.setattr(bands.Band, "of", staticmethod(lambda A: found.append(len(A))))
    dense = robodyn.kinematics(scene)
    assert found
    for path in ("q", "qd", "qdd", "singularity/psi", "singularity/passive"):
        np.testing.assert_allclose(own[path], dense[path], rtol=0, atol=1e-10, err_msg=path)
    assert own.summary["mobility"] == dense.summary["mobility"]
    ratio, wanted = (x.summary["singular_ratio"]["smallest"] for x in (own, dense))
    assert ratio == pytest.approx(wanted, rel=1e-11)
    assert ratio > guided.SINGULAR
    # the legs turn as the first one does, the bars stay level
    legs = own["q"][:, :47]
    np.testing.assert_allclose(legs, legs[:, :1] + np.zeros(47), rtol=0, atol=1e-11)
