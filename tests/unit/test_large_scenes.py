"""What grows with the number of bodies and loops: work counted, not timed."""

from __future__ import annotations

import dataclasses
import tracemalloc
from collections.abc import Iterator
from typing import Any

import pytest

from robodyn_cli import load_scene_text
from robodyn_cli.algorithms import constraints as of_constraints
from robodyn_cli.equations import constraints as of_rows
from robodyn_cli.equations.problem import Problem
from robodyn_cli.expr import fixed
from robodyn_cli.expr.graph import Expr, Graph, reachable
from robodyn_cli.formulations.index1 import projection


def windows(n: int) -> Problem:
    """A row of n four-bar windows."""
    rod = "mass: 1, com: [0.5, 0, 0], com_frame: joint, inertia: {zz: 1/12}"
    joints, links, loops = [], [], []
    for k in range(n + 1):
        joints.append(f"    - {{name: leg{k}, type: revolute, parent: base, origin: {{xyz: [{k}, 0, 0]}}, "
                      "a: 1, alpha: 0, d: 0}")  # fmt: skip
        links.append(f"    - {{name: L{k}, {rod}}}")
        if k < n:
            joints.append(f"    - {{name: bar{k}, type: revolute, parent: L{k}, a: 1, alpha: 0, d: 0}}")
            links.append(f"    - {{name: C{k}, {rod}}}")
            loops.append(f"  - {{name: w{k}, type: revolute, between: [C{k}.end, L{k + 1}.end]}}")
    lines = [
        "schema: 1",
        "gravity: [0, -9.81, 0]",
        "robot:",
        "  convention: standard",
        "  joints:",
        *joints,
        "  links:",
        *links,
    ]
    return Problem(load_scene_text("\n".join([*lines, "loops:", *loops, ""])))


def test_rates_of_rows_take_the_columns_that_rows_have() -> None:
    class Rate:
        products = 0

        def __rmul__(self, other: Any) -> float:
            Rate.products += 1
            return 0.0

    counts = []
    for n in (4, 8):
        problem, Rate.products = windows(n), 0
        problem.constraints.velocity_residual([Rate()] * problem.model.nv)
        counts.append(Rate.products)
    assert counts[0] > 0 and counts[1] == 2 * counts[0]


def test_both_corrections_share_their_factor(monkeypatch: pytest.MonkeyPatch) -> None:
    problem, made = windows(3), []
    own = of_constraints.LdlFactor.of
    monkeypatch.setattr(
        of_constraints.LdlFactor, "of", staticmethod(lambda *args: made.append(1) or own(*args))
    )
    projection(problem)
    assert len(made) == 1


def test_numbers_that_nobody_uses_are_forgotten() -> None:
    kept = [fixed.literal(1.5, f"kept.{k}") for k in range(50)]
    for k in range(3 * fixed._most[0]):
        fixed.literal(2.5, f"dropped.{k}")
    assert len(fixed._known) <= fixed._most[0]
    assert all(fixed.literal(1.5, f"kept.{k}") is x for k, x in enumerate(kept))


def test_what_is_computed_alike_is_one_number_while_it_is_in_use() -> None:
    a, b = fixed.literal(1.5, "a"), fixed.literal(2.5, "b")
    product = a * b
    assert b * a is product and (a * -b).args == (product,)
    del product
    assert float(a * b) == 3.75 and set((a * b).args) == {a, b}


def test_what_outputs_need_is_found_in_one_pass() -> None:
    """A node with many users is looked at once, and what nobody needs not at all."""
    graph, looked = Graph(), []

    class Arguments(tuple[Expr, ...]):
        def __iter__(self) -> Iterator[Expr]:
            looked.append(self)
            return super().__iter__()

    x: Any = graph.symbol("x", "q")
    layer = [x * x, x + 1.0, x - 3.0]
    unused = layer[0] / layer[2]
    for _ in range(6):
        layer = [a * b + b for a, b in zip(layer, [*layer[1:], layer[0]])]
    needed = reachable(layer)
    assert unused not in needed and [e.index for e in needed] == sorted({e.index for e in needed})
    assert set(needed) == {*layer, *(a for e in needed for a in e.args)}
    for node in graph.nodes:
        node.args = Arguments(node.args)
    assert reachable(layer) == needed and len(looked) == len(needed)
    assert reachable([1.0]) == []


def test_a_node_takes_few_bytes() -> None:
    """A large scene has a million of them."""
    graph = Graph()
    tracemalloc.start()
    try:
        x: Any = graph.symbol("x", "q")
        while len(graph.nodes) < 100_000:
            x = x * x
        used = tracemalloc.get_traced_memory()[0] / len(graph.nodes)
    finally:
        tracemalloc.stop()
    # the node (48, 16 more for the garbage collector), its arguments (56), its index (32), its places in the list (9)
    # and in the table (24 to 60): no room for a key of its own
    assert used < 230
    # memory comes in pieces of 16 bytes, so a fifth entry would take two
    assert Expr.__basicsize__ <= 48


def test_zeros_of_matrices_cost_no_operation(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two of three factors and terms are such zeros: the graph is not asked what they give."""
    graph, asked = Graph(), []
    x: Any = graph.symbol("x", "q")
    for name in ("add", "mul"):
        own = getattr(Graph, name)
        monkeypatch.setattr(Graph, name, lambda *args, own=own: asked.append(args) or own(*args))
    assert (x * 0.0, 0.0 * x, x * -0.0) == (0.0, 0.0, 0.0)
    assert x + 0.0 is x and 0.0 + x is x and not asked
    assert x * 0 == 0.0 and x + 0 is x and len(asked) == 2


def test_rows_that_depend_on_time_are_looked_for_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    problem, asked = windows(3), []
    own = of_rows.free_symbols
    monkeypatch.setattr(of_rows, "free_symbols", lambda given: asked.append(given) or own(given))
    assert problem.constraints.rheonomic == () and len(asked) == 1
    late = problem.constraints.rows[1]
    late = dataclasses.replace(late, eta=late.eta + problem.t)
    rows = (problem.constraints.rows[0], late, problem.constraints.rows[2])
    assert dataclasses.replace(problem.constraints, rows=rows).rheonomic == (1,)
