"""The open chains of the stability suite in MuJoCo, Exudyn and scipy, each at settings that a user would start with.

    python benchmarks/stability_peers.py [--cases A,B] [--json FILE]

Errors are the largest of any position or rate over its range, against the suite's own reference, whose two methods
agree. Springs and dampers of joints are the engines' own; other torques are applied from outside at each step, in
MuJoCo and in scipy. Engines that are not installed are left out.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import re
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "benchmarks")]

from robodyn_cli.expr.rebuild import Evaluator  # noqa: E402
from robodyn_cli.model.model import BASE  # noqa: E402
from robodyn_cli.run.prepare import prepare  # noqa: E402
from robodyn_cli.run.stability_cases import CASES, Case  # noqa: E402
from robodyn_cli.run.stability_suite import _spectrum  # noqa: E402
from robodyn_cli.run.trial import Budget, Reference, attempt, reference  # noqa: E402
from robodyn_cli.scene.load import load_scene_text  # noqa: E402
from tests.engines import mass_properties, real, to_mujoco, to_pinocchio  # noqa: E402

SECONDS = 5.0  # a run that takes longer is too slow
Run = Callable[[np.ndarray], np.ndarray]


class TooSlow(Exception):
    """A run has taken its time."""


class Chain:
    """What the engines are told: model, start, springs and dampers, and the torques beyond these."""

    def __init__(self, text: str) -> None:
        # engines want whole inertias; in the plane the other components have no effect
        whole = re.sub(r"inertia: \{zz: ([^}]+)\}", r"inertia: {xx: \1, yy: \1, zz: \1}", text)
        self.scene = load_scene_text(whole, "case.yaml")
        setup = prepare(self.scene)
        self.problem, self.model = setup.problem, setup.problem.model
        self.q, self.v = setup.assembled.q, setup.assembled.v
        n = self.model.nv
        self.k, self.rest, self.c = np.zeros(n), np.zeros(n), np.zeros(n)
        self.plain = True
        for body in self.model.bodies:
            for force in body.forces:
                kind = type(force.element).__name__
                if kind == "Spring":
                    self.k[body.v], self.rest[body.v] = force.element.stiffness, force.element.rest
                elif kind == "Damper":
                    self.c[body.v] = force.element.damping
                else:
                    self.plain = False
        self.plain = self.plain and not self.scene.torques
        self._applied = Evaluator(list(self.problem.applied))

    def torques(self, t: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return everything that acts on the joints but gravity."""
        return np.array(self._applied({"t": [t], "q": q, "v": v, "p": []}), dtype=float)

    def passive(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        return -self.k * (q - self.rest) - self.c * v


def with_mujoco(chain: Chain) -> Iterator[tuple[str, Run]]:
    import mujoco

    for name, kind in (
        ("Euler", "mjINT_EULER"),
        ("implicitfast", "mjINT_IMPLICITFAST"),
        ("RK4", "mjINT_RK4"),
    ):

        def run(times: np.ndarray, kind: str = kind) -> np.ndarray:
            built = to_mujoco(chain.model)
            model, data, index = built.model, built.data, built.index
            model.opt.integrator = getattr(mujoco.mjtIntegrator, kind)
            model.opt.timestep = min(model.opt.timestep, times[-1] / 1000.0)
            model.jnt_stiffness[index], model.dof_damping[index] = chain.k, chain.c
            model.qpos_spring[index] = chain.rest
            data.qpos[index], data.qvel[index] = chain.q, chain.v
            rows, end = [], time.perf_counter() + SECONDS
            h = model.opt.timestep = times[1] / np.ceil(times[1] / model.opt.timestep)
            each = round(times[1] / h)
            for k in range(len(times)):
                rows.append(np.concatenate([data.qpos[index], data.qvel[index]]))
                if k + 1 == len(times):
                    break
                for _ in range(each):
                    if not chain.plain:
                        q, v = data.qpos[index], data.qvel[index]
                        data.qfrc_applied[index] = chain.torques(data.time, q, v) - chain.passive(q, v)
                    mujoco.mj_step(model, data)
                if time.perf_counter() > end:
                    raise TooSlow
            return np.array(rows)

        yield f"MuJoCo {name}", run


def with_exudyn(chain: Chain) -> Iterator[tuple[str, Run]]:
    import exudyn as exu
    from exudyn import itemInterface as items

    in_line = [BASE, *range(len(chain.model.bodies) - 1)]
    if not chain.plain or [b.parent for b in chain.model.bodies] != in_line:
        return
    kinds = {"revolute": exu.JointType.RevoluteZ, "prismatic": exu.JointType.PrismaticZ}

    def run(times: np.ndarray) -> np.ndarray:
        container = exu.SystemContainer()
        system = container.AddSystem()
        n = chain.model.nv
        places, centres = exu.Vector3DList(), exu.Vector3DList()
        inertias, turns = exu.Matrix3DList(), exu.Matrix3DList()
        masses = []
        for body in chain.model.bodies:
            m, c, I = mass_properties(body)
            places.Append(real(body.X_tree.r))
            turns.Append(real(body.X_tree.E).T)
            centres.Append(c)
            inertias.Append(I)
            masses.append(m)
        node = system.AddNode(
            items.NodeGenericODE2(
                referenceCoordinates=[0.0] * n, initialCoordinates=list(chain.q), initialCoordinates_t=list(chain.v),
                numberOfODE2Coordinates=n,
            )
        )  # fmt: skip
        system.AddObject(
            items.ObjectKinematicTree(
                nodeNumber=node, jointTypes=[kinds[b.joint.type] for b in chain.model.bodies],
                linkParents=[b.parent for b in chain.model.bodies], jointTransformations=turns, jointOffsets=places,
                linkInertiasCOM=inertias, linkCOMs=centres, linkMasses=masses, gravity=list(real(chain.model.gravity)),
                baseOffset=[0.0] * 3, jointPControlVector=list(chain.k), jointDControlVector=list(chain.c),
                jointPositionOffsetVector=list(chain.rest), jointVelocityOffsetVector=[0.0] * n,
            )
        )  # fmt: skip
        outputs = exu.OutputVariableType
        sensors = [
            system.AddSensor(items.SensorNode(nodeNumber=node, storeInternal=True, outputVariableType=kind))
            for kind in (outputs.Coordinates, outputs.Coordinates_t)
        ]
        system.Assemble()
        settings = exu.SimulationSettings()
        t = settings.timeIntegration
        each = max(1, round(max(4000, times[-1] / 1e-3) / (len(times) - 1)))
        t.endTime, t.numberOfSteps, t.verboseMode = times[-1], each * (len(times) - 1), 0
        t.generalizedAlpha.spectralRadius = 0.9
        settings.solutionSettings.writeSolutionToFile = False
        settings.solutionSettings.sensorsWritePeriod = times[1]
        settings.displayStatistics = settings.displayComputationTime = False
        system.SolveDynamic(settings, solverType=exu.DynamicSolverType.GeneralizedAlpha)
        q, v = (system.GetSensorStoredData(s) for s in sensors)
        if len(q) < len(times):
            raise ArithmeticError("the solver gives up")
        return np.concatenate([q[:, 1:], v[:, 1:]], axis=1)[: len(times)]

    yield "Exudyn gen.-alpha", run


def with_scipy(chain: Chain) -> Iterator[tuple[str, Run]]:
    import pinocchio as pin
    from scipy.integrate import solve_ivp

    built = to_pinocchio(chain.model)
    n = chain.model.nv
    for method, rtol in (("RK45", 1e-3), ("LSODA", 1e-8), ("Radau", 1e-8)):

        def run(times: np.ndarray, method: str = method, rtol: float = rtol) -> np.ndarray:
            end = time.perf_counter() + SECONDS

            def rates(t: float, y: np.ndarray) -> np.ndarray:
                if time.perf_counter() > end:
                    raise TooSlow
                q, v = y[:n], y[n:]
                tau = chain.passive(q, v) if chain.plain else chain.torques(t, q, v)
                a = pin.aba(built.model, built.data, built.to(q), built.to(v), built.to(tau))
                return np.concatenate([v, built.ours(a)])

            start = np.concatenate([chain.q, chain.v])
            atol = 1e-6 if rtol == 1e-3 else 1e-2 * rtol
            found = solve_ivp(
                rates, (0.0, times[-1]), start, method=method, rtol=rtol, atol=atol, t_eval=times
            )
            if not found.success:
                raise ArithmeticError(found.message)
            return found.y.T

        yield f"scipy {method} {rtol:.0e}", run


ENGINES = {"mujoco": with_mujoco, "exudyn": with_exudyn, "scipy": with_scipy}


def outcome(run: Run, ref: Reference) -> dict[str, Any]:
    """Return error over range, seconds and status of a peer's run."""
    began = time.perf_counter()
    try:
        with np.errstate(all="ignore"):
            states = run(ref.times)
    except TooSlow:
        return {"status": "too_slow", "relative": None, "seconds": SECONDS}
    except Exception as error:  # a peer may fail in ways of its own
        return {
            "status": "model refused" if "inertia" in str(error) else "failed",
            "relative": None,
            "seconds": time.perf_counter() - began,
            "message": str(error),
        }
    seconds = time.perf_counter() - began
    if not np.all(np.isfinite(states)):
        return {"status": "not finite", "relative": None, "seconds": seconds}
    relative = float((np.abs(states - ref.states) / ref.scale).max())
    return {
        "status": "stable" if relative <= 1e-3 else "inaccurate",
        "relative": relative,
        "seconds": seconds,
    }


def compare(case: Case) -> dict[str, Any] | None:
    """Return what robodyn and its peers do with a case; None for mechanisms that are no open chain."""
    text = case.text(True)
    try:
        chain = Chain(text)
    except Exception:
        return None
    if chain.model.closures or not case.peers or any(b.joint.nv != 1 for b in chain.model.bodies):
        return None
    _, stiff = _spectrum(chain.scene)
    ref = reference(chain.scene, Budget(2_000_000, 20.0), stiff)
    if ref is None:
        return None
    own = attempt(chain.scene, "auto", ref, Budget(2_000_000, 20.0))
    found = {"robodyn auto": {"status": own.status, "relative": own.relative, "seconds": own.seconds}}
    for module, entries in ENGINES.items():
        if importlib.util.find_spec(module) is None:
            continue
        for name, run in entries(chain):
            found[name] = outcome(run, ref)
    return {"case": case.name, "until": ref.until, "digits": ref.digits, "runs": found}


def shown(run: dict[str, Any] | None) -> str:
    if run is None:
        return ""
    if run["relative"] is None:
        return str(run["status"]).replace("_", " ")
    return f"{run['relative']:.0e}" + (" !" if run["status"] == "inaccurate" else "")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--cases", default="", help="names of the suite's cases; default: all that are open chains"
    )
    parser.add_argument("--json", type=Path, help="write everything there")
    options = parser.parse_args()
    names = options.cases.split(",") if options.cases else [c.name for c in CASES]
    rows = []
    for case in (c for c in CASES if c.name in names):
        row = compare(case)
        if row is not None:
            rows.append(row)
            print(case.name, {k: shown(v) for k, v in row["runs"].items()}, file=sys.stderr, flush=True)
    columns = list(dict.fromkeys(name for row in rows for name in row["runs"]))
    print("| case | " + " | ".join(columns) + " |")
    print("|---" * (len(columns) + 1) + "|")
    for row in rows:
        print(f"| {row['case']} | " + " | ".join(shown(row["runs"].get(c)) for c in columns) + " |")
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
