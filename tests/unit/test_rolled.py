"""Rolled kernels against the unrolled ones and the algorithms on plain numbers."""

from __future__ import annotations

import ctypes
import dataclasses
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from robodyn_cli.algorithms.aba import aba
from robodyn_cli.algorithms.rnea import rnea
from robodyn_cli.errors import CapabilityError
from robodyn_cli.expr.graph import Graph
from robodyn_cli.joints.base import Joint
from robodyn_cli.joints.registry import joint_types
from robodyn_cli.joints.single_axis import Helical
from robodyn_cli.kernels.compiler import REPORT, compile_module, machine
from robodyn_cli.kernels.crossover import prefer_rolled
from robodyn_cli.kernels.ir import module
from robodyn_cli.kernels.rolled import kernels as rolled
from robodyn_cli.kernels.rolled.kernels import (
    RolledForwardDynamics,
    RolledInverseDynamics,
    RolledPlan,
)
from robodyn_cli.kernels.rolled.loops import rolled_function, tree_function, write_sample_kernel
from robodyn_cli.kernels.samples import SampleKernel
from robodyn_cli.model.model import BASE, UNKNOWN_GROUP, FixedFrame, Loop, Model
from robodyn_cli.spatial.algebra import (
    Transform,
    identity,
    matrix,
    rotation_about,
    vector,
    zeros,
)
from robodyn_cli.spatial.inertia import RigidInertia
from tests.numeric import assert_close, real
from tests.random_models import random_tree, shuffled
from tests.wide_joints import wide_joints

Samples = tuple[np.ndarray, np.ndarray, np.ndarray]


def samples(model: Model, count: int, seed: int = 0) -> Samples:
    """Random q, qd and a third array; rates small enough that long chains do not explode."""
    rng = np.random.default_rng([seed, model.nv])
    rate = min(1.0, 3.0 / model.nv)
    return (
        rng.uniform(-3, 3, (count, model.nq)),
        rng.normal(size=(count, model.nv)) * rate,
        rng.normal(size=(count, model.nv)),
    )


def numeric_rnea(model: Model, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    rows = [rnea(model, *(row.tolist() for row in rows), model.gravity) for rows in zip(q, v, a)]
    return np.stack([real(row) for row in rows])


def numeric_aba(model: Model, q: np.ndarray, v: np.ndarray, tau: np.ndarray) -> np.ndarray:
    rows = [aba(model, *(row.tolist() for row in rows), model.gravity) for rows in zip(q, v, tau)]
    return np.stack([real(row) for row in rows])


def planar(model: Model, gravity: list[float], base: np.ndarray | None = None) -> Model:
    """The same tree with all axes parallel, and only the inertia that a planar motion needs known."""
    graph = Graph()
    bodies = []
    for k, body in enumerate(model.bodies):
        place = Transform(identity(), vector([0.4, 0.1, 0.0]))
        if k == 0 and base is not None:
            place = Transform(matrix(base.tolist()), zeros(3))
        unknown = graph.symbols([f"link{k}.{name}" for name in "abcde"], UNKNOWN_GROUP)
        h = vector([body.inertia.h[0], body.inertia.h[1], 0.0])
        I = zeros(3, 3)
        for x, (i, j) in zip(unknown, ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2))):
            I[i, j] = I[j, i] = x
        I[2, 2] = body.inertia.I[2, 2]
        inertia = RigidInertia(body.inertia.m, h, I)
        bodies.append(dataclasses.replace(body, X_tree=place, inertia=inertia))
    return dataclasses.replace(model, bodies=tuple(bodies), gravity=vector(gravity), graph=graph)


def tilted(model: Model) -> Model:
    """The same model with the second axis across the first."""
    first, second, *others = model.bodies
    across = Transform(rotation_about(0, np.pi / 2), second.X_tree.r)
    return dataclasses.replace(model, bodies=(first, dataclasses.replace(second, X_tree=across), *others))


def with_joints(model: Model, joints: list[Joint]) -> Model:
    """Give the bodies other joints, in turn, and number the coordinates anew."""
    bodies, nq, n = [], 0, 0
    for k, body in enumerate(model.bodies):
        joint = joints[k % len(joints)]
        bodies.append(dataclasses.replace(body, joint=joint, q=nq, v=n))
        nq, n = nq + joint.nq, n + joint.nv
    return dataclasses.replace(model, bodies=tuple(bodies), nq=nq, nv=n)


# -- agreement ----------------------------------------------------------------------------------------------
def test_long_chain_agrees_with_unrolled_kernels_and_plain_numbers() -> None:
    model = random_tree(100, 1, branching=0.0)
    q, v, x = samples(model, 19)
    g = Graph()
    names = [str(k) for k in range(model.nv)]
    symbols = [g.symbols(names, group) for group in ("q", "v", "x")]
    for function, kernel, numeric, tolerance in (
        (rnea, RolledInverseDynamics(model), numeric_rnea, 1e-13),
        (aba, RolledForwardDynamics(model), numeric_aba, 1e-10),
    ):
        got = kernel(q, v, x)
        unrolled = SampleKernel({"out": function(model, *symbols, model.gravity)}, ["q", "v", "x"])
        assert_close(got, unrolled(q=q, v=v, x=x)["out"], tolerance)
        assert_close(got[:2], numeric(model, q[:2], v[:2], x[:2]), tolerance)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("branching", [0.0, 0.3, 0.9])
@pytest.mark.parametrize("kinds", [("revolute", "prismatic"), ("revolute",), ("prismatic",)])
def test_random_trees(seed: int, branching: float, kinds: tuple[str, ...]) -> None:
    model = random_tree(1 + 3 * seed, seed, branching=branching, kinds=kinds, armature=seed % 2 == 0)
    if seed % 3 == 2:
        model = shuffled(model, seed)
    q, v, x = samples(model, 9, seed)
    tau = RolledInverseDynamics(model)(q, v, x)
    assert_close(tau[::4], numeric_rnea(model, q[::4], v[::4], x[::4]), 1e-13)
    qdd = RolledForwardDynamics(model)(q, v, x)
    assert_close(qdd[::4], numeric_aba(model, q[::4], v[::4], x[::4]), 1e-11)
    assert_close(RolledForwardDynamics(model)(q, v, tau), x, 1e-10)


def test_star_and_combs_use_the_branch_slots() -> None:
    model = random_tree(9, 4, branching=0.0)
    for parents in (
        [BASE] * 9,
        [BASE, 0, 0, 0, 0, 0, 0, 0, 0],
        [BASE, 0, 1, 1, 0, 4, 4, 0, BASE],
        [BASE, 0, 0, 1, 1, 2, 2, 3, 3],
    ):
        tree = dataclasses.replace(
            model,
            bodies=tuple(dataclasses.replace(b, parent=p) for b, p in zip(model.bodies, parents)),
        )
        q, v, x = samples(tree, 9)
        assert_close(RolledInverseDynamics(tree)(q, v, x)[:3], numeric_rnea(tree, q[:3], v[:3], x[:3]), 1e-13)
        assert_close(RolledForwardDynamics(tree)(q, v, x)[:3], numeric_aba(tree, q[:3], v[:3], x[:3]), 1e-11)


@pytest.mark.parametrize("branching", [0.0, 0.5])
def test_joints_beyond_the_registry(branching: float) -> None:
    joints = [Helical(0.3), joint_types["revolute"], Helical(-0.2), *wide_joints.values()]
    model = with_joints(random_tree(11, 8, branching=branching), joints)
    q, v, x = samples(model, 9)
    for body in model.bodies:
        own = slice(body.q, body.q + body.joint.nq)
        q[:, own] = [body.joint.normalise(row) for row in q[:, own]]
    tau = RolledInverseDynamics(model)(q, v, x)
    assert_close(tau[:3], numeric_rnea(model, q[:3], v[:3], x[:3]), 1e-13)
    assert_close(RolledForwardDynamics(model)(q, v, tau), x, 1e-11)
    assert len(RolledPlan(model, "inverse").recursion.sweeps[0].steps) == len(joints)


@pytest.mark.parametrize("n", [100, 300])
def test_forward_dynamics_inverts_inverse_dynamics_of_long_chains(n: int) -> None:
    model = random_tree(n, 5, branching=0.0, kinds=("revolute",))
    q, v, x = samples(model, 16)
    forward, inverse = RolledForwardDynamics(model), RolledInverseDynamics(model)
    tau = inverse(q, v, x)
    # the torques of a long chain are large beside those that its lightest joints feel
    assert_close(inverse(q, v, forward(q, v, tau)), tau, 1e-12)
    assert_close(forward(q, v, tau), x, 1e-8)


# -- lanes and memory ---------------------------------------------------------------------------------------
def test_any_number_of_samples() -> None:
    model = random_tree(6, 2)
    q, v, x = samples(model, 1001)
    for kernel in (RolledInverseDynamics(model), RolledForwardDynamics(model)):
        whole = kernel(q, v, x)
        assert_close(whole[[0, 500, 1000]], kernel(*(a[[0, 500, 1000]] for a in (q, v, x))), 0.0)
        for count in (0, 1, 7, 8, 9, 64, 65):
            part = kernel(q[:count], v[:count], x[:count])
            assert part.shape == (count, 6)
            assert np.array_equal(part, whole[:count])


def test_any_order_in_memory() -> None:
    model = random_tree(5, 2)
    q, v, x = samples(model, 30)
    kernel = RolledInverseDynamics(model)
    expected = kernel(q, v, x)
    assert np.array_equal(expected, kernel(*(np.asfortranarray(a) for a in (q, v, x))))
    assert np.array_equal(expected, kernel(*(np.repeat(a, 2, axis=0)[::2] for a in (q, v, x))))
    assert np.array_equal(expected[::-1], kernel(q[::-1], v[::-1], x[::-1]))
    for wrong in (q[:, :4], q[:29], q[:, 0]):
        with pytest.raises(ValueError, match="shape"):
            kernel(wrong, v, x)


@pytest.mark.parametrize("count", [63, 64, 65, 129])
def test_many_columns_go_in_chunks(count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    model = random_tree(6, 3)
    inputs = samples(model, count)
    for kernel in (RolledInverseDynamics(model), RolledForwardDynamics(model)):
        expected = kernel(*inputs)
        with monkeypatch.context() as patch:
            patch.setattr(rolled, "MANY_COLUMNS", 1)
            patch.setattr(rolled, "MANY_BYTES", 0)
            assert np.array_equal(kernel(*inputs), expected)
            assert np.array_equal(kernel(*(np.asfortranarray(a) for a in inputs)), expected)


@pytest.mark.parametrize("branching", [0.0, 0.6])
def test_not_a_number_stays_in_its_sample(branching: float) -> None:
    model = random_tree(8, 6, branching=branching, kinds=("revolute",))
    q, v, x = samples(model, 21)
    for kernel in (RolledInverseDynamics(model), RolledForwardDynamics(model)):
        clean = kernel(q, v, x)
        for array in (q, v, x):
            for bad in (np.nan, np.inf):
                before, array[10, 3] = array[10, 3], bad
                found = kernel(q, v, x)
                array[10, 3] = before
                assert not np.isfinite(found[10, 3])
                assert np.array_equal(np.delete(found, 10, 0), np.delete(clean, 10, 0))
        assert np.array_equal(kernel(q, v, x), clean)


def test_a_kernel_may_be_called_from_several_threads() -> None:
    model = random_tree(20, 7, branching=0.3)
    kernel = RolledForwardDynamics(model)
    inputs = [samples(model, 400, seed) for seed in range(8)]
    expected = [kernel(*i) for i in inputs]
    with ThreadPoolExecutor(4) as pool:
        for _ in range(5):
            for got, want in zip(pool.map(lambda i: kernel(*i), inputs), expected):
                assert np.array_equal(got, want)


@pytest.mark.parametrize("lanes", [2, 4])
@pytest.mark.parametrize("fused", [True, False])
def test_fewer_lanes(lanes: int, fused: bool) -> None:
    if fused and not machine().fused:
        pytest.skip("needs fused multiply-add")
    model = random_tree(7, 9, branching=0.4)
    q, v, x = (np.asfortranarray(a) for a in samples(model, 11))
    plan = RolledPlan(model, "forward")
    code = compile_module(
        f"test {lanes} {fused} {plan.digest}",
        lambda: write_sample_kernel(plan.recursion, plan.serial, lanes, fused),
    )
    out = np.empty((11, 7), order="F")
    call = code.function("kernel", *[ctypes.c_void_p] * 6, ctypes.c_int64)
    memory = [plan.tables, q, v, x, out, plan.scratch(lanes)]
    call(*(a.ctypes.data for a in memory), 11)
    assert_close(out, RolledForwardDynamics(model)(q, v, x), 1e-12)


def right_hand_side(plan: RolledPlan, width: int, *samples: np.ndarray) -> np.ndarray:
    """Call the function that a stepping loop calls, for so many states at once (width, nv)."""
    code = compile_module(
        f"test state {width} {plan.digest}",
        lambda: module(
            [rolled_function(tree_function("rhs"), plan.recursion, plan.serial, width, machine().fused)]
        ),
    )
    arrays = [np.ascontiguousarray(a.T) for a in samples]
    out = np.empty((plan.nv, width))
    memory = [plan.tables, *arrays, out, plan.scratch(width)]
    code.function("rhs", *[ctypes.c_void_p] * 6)(*(a.ctypes.data for a in memory))
    return out.T


@pytest.mark.parametrize("branching", [0.0, 0.5])
def test_right_hand_side_of_one_state(branching: float) -> None:
    model = shuffled(random_tree(12, 10, branching=branching), 1)
    q, v, x = samples(model, 8)
    for kernel in (RolledForwardDynamics(model), RolledInverseDynamics(model)):
        expected = kernel(q, v, x)
        # one state, and four at once, as a stepping loop calls it
        for width in (1, 4):
            found = right_hand_side(kernel.plan, width, *(a[:width] for a in (q, v, x)))
            assert_close(found, expected[:width], 1e-12)


# -- one code for many models -------------------------------------------------------------------------------
def test_one_object_serves_all_chains() -> None:
    for cls in (RolledInverseDynamics, RolledForwardDynamics):
        first = cls(random_tree(5, 1, branching=0.0, kinds=("revolute",)))
        before = REPORT.compiled + REPORT.cached
        other = random_tree(50, 2, branching=0.0, kinds=("revolute",))
        second = cls(other)
        assert REPORT.compiled + REPORT.cached == before  # not even looked for on the disk
        assert first.plan.digest == second.plan.digest
        q, v, x = samples(other, 3)
        numeric = numeric_rnea if cls is RolledInverseDynamics else numeric_aba
        assert_close(second(q, v, x), numeric(other, q, v, x), 1e-11)
    digests = {
        RolledPlan(random_tree(6, 1, branching=b, kinds=k, armature=a), "forward").digest
        for b in (0.0, 0.9)
        for k in (("revolute",), ("prismatic",))
        for a in (True, False)
    }
    assert len(digests) == 8


@pytest.mark.parametrize("branching", [0.0, 0.4])
def test_planar_motion_needs_only_planar_arithmetic_and_data(branching: float) -> None:
    upright = rotation_about(0, np.pi / 2).T
    for gravity, base in (([0.0, -9.81, 0.0], None), ([0.0, 0.0, -9.81], upright)):
        n = 12
        tree = random_tree(n, 11, branching=branching, kinds=("revolute",))
        if base is not None:  # one root, which stands upright
            bodies = [dataclasses.replace(b, parent=max(b.parent, 0)) for b in tree.bodies[1:]]
            tree = dataclasses.replace(tree, bodies=(tree.bodies[0], *bodies))
        model = planar(tree, gravity, base)
        inverse, forward = RolledInverseDynamics(model), RolledForwardDynamics(model)
        assert inverse.plan.recursion.operations < 60
        assert forward.plan.recursion.operations < 180
        q, v, x = samples(model, 9)
        g = model.graph
        names = [str(k) for k in range(n)]
        symbols = [g.symbols(names, group) for group in ("q", "v", "x")]
        unrolled = SampleKernel({"out": rnea(model, *symbols, model.gravity)}, ["q", "v", "x"])
        tau = inverse(q, v, x)
        assert_close(tau, unrolled(q=q, v=v, x=x)["out"], 1e-13)
        assert_close(forward(q, v, tau), x, 1e-10)


# -- what is refused ----------------------------------------------------------------------------------------
def test_refusals_name_the_reason() -> None:
    model = random_tree(4, 12, branching=0.0)
    with pytest.raises(CapabilityError, match=r"link0.*link0\.a"):
        RolledInverseDynamics(tilted(planar(model, [0.0, -9.81, 0.0])))
    symbolic = dataclasses.replace(model, gravity=vector([0.0, model.graph.symbol("g", "p", 0), 0.0]))
    with pytest.raises(CapabilityError, match="gravity"):
        RolledForwardDynamics(symbolic)
    bodies = (dataclasses.replace(model.bodies[0], joint=joint_types["fixed"]), *model.bodies[1:])
    with pytest.raises(CapabilityError, match="fixed"):
        RolledInverseDynamics(dataclasses.replace(model, bodies=bodies))
    with pytest.raises(CapabilityError, match="one moving body"):
        RolledInverseDynamics(dataclasses.replace(model, bodies=(), nq=0, nv=0))
    end = FixedFrame(0, zeros(3), identity())
    closed = dataclasses.replace(model, loops=(Loop("pin", None, end, end),))
    with pytest.raises(CapabilityError, match="loops"):
        RolledForwardDynamics(closed)
    RolledInverseDynamics(closed)


def test_preference() -> None:
    assert not prefer_rolled(random_tree(7, 1))
    long = random_tree(40, 1)
    assert prefer_rolled(long)
    assert not prefer_rolled(tilted(planar(long, [0.0, -9.81, 0.0])))
    assert prefer_rolled(planar(random_tree(40, 1, kinds=("revolute",)), [0.0, -9.81, 0.0]))
    end = FixedFrame(0, zeros(3), identity())
    assert not prefer_rolled(dataclasses.replace(long, loops=(Loop("pin", None, end, end),)))
