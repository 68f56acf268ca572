"""Functions of a model from Python beside Pinocchio: microseconds a state on one core.

    python benchmarks/model_functions.py [--quick] [--json FILE]

M, C, G, the Jacobian of the last link, and the derivatives of inverse and forward dynamics of a seven-joint arm.
robodyn evaluates all states in one call of ``Mechanism``; Pinocchio has no call for many states, so its fastest way
from Python is a loop of its compiled functions, one call a state, results left in its own memory. The two take turns.
Machine code only: the first 200 000 states of a kernel are interpreted, and compiling is not part of the time.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any

import measure

measure.single_thread()

import arms  # noqa: E402
import numpy as np  # noqa: E402

from robodyn_cli import Mechanism, load_scene_text  # noqa: E402

Call = Callable[[Any, Any, Any], Any]
# how many times as fast as Pinocchio each function is to be
TARGETS = {"M": 10, "C": 10, "G": 10, "Jacobian": 10, "d tau": 8, "d qdd": 8}


def own_calls(mechanism: Mechanism) -> dict[str, Call]:
    """Return robodyn's functions of arrays of states (q, qd, x)."""
    return {
        "M": lambda q, v, x: mechanism.mass_matrix(q),
        "C": lambda q, v, x: mechanism.coriolis(q, v),
        "G": lambda q, v, x: mechanism.gravity(q),
        "Jacobian": lambda q, v, x: mechanism.jacobian("link7", q),
        "d tau": mechanism.inverse_dynamics_derivatives,
        "d qdd": mechanism.forward_dynamics_derivatives,
    }


def peer_calls(pin: Any, model: Any) -> dict[str, Call]:
    """Return Pinocchio's functions of one state."""
    data, last = model.createData(), model.njoints - 1
    aligned, place = pin.LOCAL_WORLD_ALIGNED, pin.SE3.Identity()

    def jacobian(q: Any, v: Any, x: Any) -> Any:
        pin.computeJointJacobians(model, data, q)
        return pin.getFrameJacobian(model, data, last, place, aligned)

    return {
        "M": lambda q, v, x: pin.crba(model, data, q),
        "C": lambda q, v, x: pin.computeCoriolisMatrix(model, data, q, v),
        "G": lambda q, v, x: pin.computeGeneralizedGravity(model, data, q),
        "Jacobian": jacobian,
        "d tau": lambda q, v, x: pin.computeRNEADerivatives(model, data, q, v, x),
        "d qdd": lambda q, v, x: pin.computeABADerivatives(model, data, q, v, x),
    }


def arrays(result: Any) -> list[Any]:
    """Return a result as arrays: derivatives by positions and rates."""
    if hasattr(result, "dq"):
        return [result.dq, result.dqd]
    return list(result[:2]) if isinstance(result, tuple) else [result]


def difference(name: str, own: Any, theirs: Any) -> float:
    """Return the largest difference between the two at one state, relative to the largest entry."""
    found = []
    for a, b in zip(arrays(own), arrays(theirs)):
        b = np.array(b)
        if name == "M":
            b = np.triu(b) + np.triu(b, 1).T
        if name == "Jacobian":
            b = np.concatenate([b[3:], b[:3]])  # linear rows first
        found.append(float(np.abs(a - b).max() / np.abs(b).max()))
    return max(found)


def bench(report: measure.Report, samples: int, repeats: int) -> None:
    """Time all functions with both engines; add a row for each to the report."""
    pin = importlib.import_module("pinocchio") if report.has("pinocchio") else None
    arm = arms.seven_joint_arm()
    mechanism = Mechanism(load_scene_text(arms.scene_text(arm)))
    q, v, x = arms.motion(arm.n, samples)
    states = list(zip(*(np.ascontiguousarray(a) for a in (q, v, x))))
    peers = peer_calls(pin, arms.pinocchio_model(arm)) if pin is not None else {}
    for name, own in own_calls(mechanism).items():
        calls: dict[str, Any] = {"robodyn": lambda f=own: f(q, v, x)}
        measure.warmed(calls["robodyn"], samples)
        if peers:

            def loop(f: Call = peers[name]) -> None:
                for state in states:
                    f(*state)

            calls["pinocchio"] = loop
        times = measure.alternate(calls, repeats)
        row = {"function": name, "target": TARGETS[name]}
        row |= {f"{engine}_us": 1e6 * measure.median(found) / samples for engine, found in times.items()}
        if peers:
            row["faster"] = measure.median_ratio(times["pinocchio"], times["robodyn"])
            row["differ"] = max(difference(name, own(*s), peers[name](*s)) for s in states[:: samples // 20])
        report.rows.append(row)


def main() -> None:
    options = measure.command_line(__doc__).parse_args()
    samples, repeats = 10_000, 3 if options.quick else 15
    measure.print_machine()
    print(f"7-joint arm, {samples} states a call, one core, medians of {repeats} alternating repeats\n")
    with measure.reporting(options.json) as report:
        report.more |= {"samples": samples, "repeats": repeats}
        bench(report, samples, repeats)
        head = ["function", "robodyn us", "Pinocchio us", "times faster", "target", "between them"]
        keys = (
            ("robodyn_us", ".4f"),
            ("pinocchio_us", ".3f"),
            ("faster", ".1f"),
            ("target", "d"),
            ("differ", ".1e"),
        )
        lines = [
            [r["function"], *(format(r[k], form) if k in r else "-" for k, form in keys)] for r in report.rows
        ]
        print(measure.table([head, *lines]))


if __name__ == "__main__":
    main()
