"""MuJoCo: its own loop (``rollout``), fixed steps; the four-bar closed by a ``connect`` equality made stiff."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import arms
import numpy as np
from cases import Chain, Entry, FourBar

STEPS = {
    "RK4": (1e-2, 2e-3, 1e-3, 2e-4, 1e-4),
    "implicitfast": (2e-3, 1e-3, 2e-4, 1e-4, 2e-5),
    "Euler": (2e-3, 1e-3, 1e-4),
}


def chain_xml(case: Chain) -> str:
    arm = case.arm
    bodies = ""
    for k in range(case.n):
        _, place = arms.placement(arm, k)
        half = arm.alpha[k] / 2
        c, I = arm.com[k], arm.inertia[k]
        entries = (I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[0, 2], I[1, 2])
        bodies += (
            f'<body pos="{_text(place)}" quat="{_text((np.cos(half), np.sin(half), 0, 0))}"><inertial '
            f'pos="{_text(c)}" mass="{arm.mass[k]:.17g}" fullinertia="{_text(entries)}"/><joint type="hinge" '
            f'axis="0 0 1" stiffness="{case.k[k]:.17g}" damping="{case.c[k]:.17g}"/>'
        )
    world = f"<worldbody>{bodies}{'</body>' * case.n}</worldbody>"
    return (
        f'<mujoco><compiler angle="radian" boundmass="0" boundinertia="0"/><option '
        f'gravity="{_text(arm.gravity)}"><flag contact="disable"/></option>{world}</mujoco>'
    )


def _text(numbers: Any) -> str:
    return " ".join(f"{float(x):.17g}" for x in numbers)


def four_bar_xml(case: FourBar, reference: str) -> str:
    l0, l1, l2, _ = case.lengths

    def inertial(k: int) -> str:
        i = f"{case.inertia[k]} " * 3
        return f'<inertial pos="{case.com[k]} 0 0" mass="{case.mass[k]}" diaginertia="{i.strip()}"/>'

    # anchors are matched in the pose q = 0, where l1 + l2 = l0 + l3 closes the loop exactly
    hinge = 'type="hinge" axis="0 0 1"'
    return (
        f'<mujoco><compiler angle="radian" autolimits="false"/><option gravity="0 0 0"><flag contact="disable"/>'
        f'</option><worldbody><body><joint name="crank" {hinge} stiffness="{case.torque[1]}"/>{inertial(0)}'
        f'<body name="coupler" pos="{l1} 0 0"><joint {hinge}/>{inertial(1)}</body></body>'
        f'<body name="follower" pos="{l0} 0 0"><joint {hinge}/>{inertial(2)}</body></worldbody><equality>'
        f'<connect body1="coupler" body2="follower" anchor="{l2} 0 0" {reference}/></equality>'
        f'<actuator><motor joint="crank"/></actuator></mujoco>'
    )


def _start(model: Any, data: Any, q: Any) -> np.ndarray:
    import mujoco

    mujoco.mj_resetData(model, data)
    data.qpos[:] = q
    kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
    first = np.zeros(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, data, first, kind)
    return first


def _integrator(name: str) -> int:
    import mujoco

    return int(getattr(mujoco.mjtIntegrator, f"mjINT_{name.upper()}"))


def entries(case: Any) -> Iterator[Entry]:
    import mujoco
    from mujoco import rollout

    if isinstance(case, FourBar):
        yield from _to_lock(case)
        return
    n = case.n
    for kind in ("implicitfast", "Euler") if case.stiff else ("RK4",):
        for step in STEPS[kind]:
            if kind == "RK4" and round(case.duration / step) > 100_000:
                continue
            model = mujoco.MjModel.from_xml_string(chain_xml(case))
            model.opt.timestep, model.opt.integrator = step, _integrator(kind)
            data = mujoco.MjData(model)
            first = _start(model, data, case.start)
            count = round(case.duration / step)

            def roll(
                model: Any = model, data: Any = data, first: Any = first, count: int = count
            ) -> np.ndarray:
                states: np.ndarray = rollout.rollout(model, [data], first[None], nstep=count)[0][0]
                return states

            def run(roll: Any = roll, count: int = count) -> tuple[np.ndarray, int]:
                return roll()[-1, 1 : 1 + 2 * n], count

            def path(roll: Any = roll) -> tuple[np.ndarray, np.ndarray]:
                states = roll()
                return states[:, 0], states[:, 1 : 1 + 2 * n]

            yield Entry(f"MuJoCo {kind}", f"step {step:g}", run, path if case.whole else None)


def _to_lock(case: FourBar) -> Iterator[Entry]:
    import mujoco
    from mujoco import rollout

    a, b, c = case.angles
    for kind in ("RK4", "Euler"):
        for step in (1e-3, 1e-4):
            model = mujoco.MjModel.from_xml_string(
                four_bar_xml(case, 'solref="-1e7 -1e4" solimp="0.9999 0.9999 0.001"')
            )
            model.opt.timestep, model.opt.integrator = step, _integrator(kind)
            data = mujoco.MjData(model)
            first = _start(model, data, (a, b - a, c))
            count = round(12.4 / step)

            def run(
                model: Any = model, data: Any = data, first: Any = first, count: int = count
            ) -> tuple[float, int]:
                preload = np.full((1, count, 1), case.torque[0])
                states = rollout.rollout(model, [data], first[None], control=preload, nstep=count)[0][0]
                return aligned(states[:, 0], states[:, 1] + states[:, 2] - states[:, 3]), count

            yield Entry(f"MuJoCo {kind}, connect", f"step {step:g}", run)


def aligned(times: np.ndarray, difference: np.ndarray) -> float:
    """Return when the sine of an angle first changes sign, linearly between samples; NaN if never."""
    s = np.sin(difference)
    late = np.flatnonzero(times > 0.05)
    s, times = s[late], times[late]
    found = np.flatnonzero(s[:-1] * s[1:] < 0)
    if not len(found):
        return float("nan")
    k = found[0]
    return float(times[k] + (times[k + 1] - times[k]) * s[k] / (s[k] - s[k + 1]))
