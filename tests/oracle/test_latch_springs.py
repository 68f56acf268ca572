"""Springs with dampers that hold joints and closures of open chains and loops, beside an integration from event to event
of the one coordinate that these mechanisms have."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.integrate import solve_ivp
from scipy.optimize import minimize_scalar

from robodyn_cli.scene.load import load_scene_text
from robodyn_cli.works.deploy.deploy import deploy

EXPLORE = int(os.environ.get("ROBODYN_EXPLORE", "0"))
SEEDS = range(5) if not EXPLORE else range(1000, 1000 + 15 * EXPLORE)
ORACLE = 1e-9  # of a figure: what scipy's tolerances leave behind many rebounds (measured at looser ones)
AXIS = [0, 0, 1]
HELD = {
    "panel": {"joint": "crank"},
    "closure": {"between": ["bar", "cart"]},
    "rod": {"joint": "rod"},
    "slide": {"joint": "slide"},
}


class Crank:
    """A crank with its bar and cart, or a panel alone, that a torque drives from `start` through the place `at`."""

    def __init__(self, held: str, rng: np.random.Generator) -> None:
        self.held, self.alone = held, held == "panel"
        self.r, self.l = float(rng.uniform(0.2, 0.35)), float(rng.uniform(0.6, 0.8))
        self.arm, self.bar, self.cart = rng.uniform(0.5, 2.0, 3).tolist()
        self.torque = float(rng.uniform(2.0, 4.0)), float(rng.uniform(6.0, 9.0)), float(rng.uniform(4.0, 8.0))
        self.start, self.at = (
            float(np.radians(rng.uniform(-70.0, -40.0))),
            float(np.radians(rng.uniform(30.0, 50.0))),
        )
        self.k = float(rng.uniform(60.0, 150.0) * (10.0 if held == "slide" else 1.0))
        self.c = float(self.k * rng.uniform(0.01, 0.1))

    def closed(self, theta: float) -> tuple[float, float, float]:
        """Return the angle of the bar and its derivatives: r sin theta + l sin phi = 0."""
        phi = np.arcsin(-self.r * np.sin(theta) / self.l)
        d = -self.r * np.cos(theta) / (self.l * np.cos(phi))
        return phi, d, (self.r * np.sin(theta) + self.l * np.sin(phi) * d * d) / (self.l * np.cos(phi))

    def inertia(self, theta: float) -> tuple[float, float]:
        """Return m and m'/2 of the kinetic energy m theta-dot^2 / 2."""
        own = self.arm * (0.01 + (0.5 * self.r) ** 2)
        if self.alone:
            return own, 0.0
        phi, d, dd = self.closed(theta)
        s, c = (np.sin(theta), np.sin(phi)), (np.cos(theta), np.cos(phi))
        half = 0.5 * self.l
        x, y = -self.r * s[0] - half * s[1] * d, self.r * c[0] + half * c[1] * d
        xx = -self.r * c[0] - half * (c[1] * d * d + s[1] * dd)
        yy = -self.r * s[0] + half * (c[1] * dd - s[1] * d * d)
        z, zz = x - half * s[1] * d, xx - half * (c[1] * d * d + s[1] * dd)
        m = own + self.bar * (x * x + y * y + 0.05 * d * d) + self.cart * z * z
        return m, self.bar * (x * xx + y * yy + 0.05 * d * dd) + self.cart * z * zz

    def place(self, theta: float) -> tuple[float, float]:
        """Return what the latch holds, and its derivative."""
        if self.alone:
            return theta, 1.0
        phi, d, _ = self.closed(theta)
        reach = (
            self.r * np.cos(theta) + self.l * np.cos(phi),
            -self.r * np.sin(theta) - self.l * np.sin(phi) * d,
        )
        return {"closure": (-phi, -d), "rod": (phi - theta, d - 1.0), "slide": reach}[self.held]

    def scene(self, duration: float, samples: int, **deploy: Any) -> dict[str, Any]:
        a, b, w = self.torque
        joints = [{"name": "crank", "type": "revolute", "axis": AXIS, "parent": "base", "link": "arm"}]
        links = [
            {"name": "arm", "mass": self.arm, "com": [0.5 * self.r, 0, 0], "inertia": {"zz": 0.01 * self.arm}}
        ]
        initial: dict[str, Any] = {"crank": self.start}
        more: dict[str, Any] = {}
        if not self.alone:
            origin = {"xyz": [self.r, 0, 0]}
            joints += [
                {"name": "rod", "type": "revolute", "axis": AXIS, "parent": "arm", "link": "bar", "origin": origin},
                {"name": "slide", "type": "prismatic", "axis": [1, 0, 0], "parent": "base", "link": "cart"},
            ]  # fmt: skip
            links += [
                {"name": "bar", "mass": self.bar, "com": [0.5 * self.l, 0, 0], "inertia": {"zz": 0.05 * self.bar}},
                {"name": "cart", "mass": self.cart},
            ]  # fmt: skip
            phi = self.closed(self.start)[0]
            initial |= {"rod": phi - self.start, "slide": self.r * np.cos(self.start) + self.l * np.cos(phi)}
            more["loops"] = [{"name": "wrist", "type": "revolute", "between": ["pin", "cart.origin"]}]
            more["actuated"] = ["crank"]
        robot: dict[str, Any] = {"joints": joints, "links": links}
        if not self.alone:
            robot["points"] = {"pin": {"link": "bar", "at": [self.l, 0, 0]}}
        latch = {"name": "soft", **HELD[self.held], "hold": {"stiffness": self.k, "damping": self.c}}
        return {
            "schema": 1, "gravity": [0, 0, 0], "robot": robot, **more, "torques": {"crank": f"{a} + {b}*sin({w}*t)"},
            "initial": {"q": {key: float(x) for key, x in initial.items()}, "hold": ["crank"]},
            "simulate": {"duration": duration, "samples": samples},
            "deploy": {"latches": [{**latch, "at": {"crank": self.at}}], "until": "end", **deploy},
            "outputs": {"extremes": ["latch_loads.soft"]},
        }  # fmt: skip

    def course(self, duration: float, ends: float = np.inf) -> tuple[float, float, int, float]:
        """Return the largest load with its time, how often the spring is left, and the end.

        ends : where the crank is stopped for good.
        """
        a, b, w = self.torque
        rest, _ = self.place(self.at)
        side = 0.0

        def depth(y: Any) -> tuple[float, float]:
            value, slope = self.place(y[0])
            return side * (value - rest), side * slope * y[1]

        def load(y: Any) -> float:
            delta, rate = depth(y)
            return self.k * delta + self.c * rate

        def advance(pushes: bool, events: list[Callable[[Any], float]], falling: list[int]) -> Any:
            def rates(t: float, y: Any) -> list[float]:
                m, half = self.inertia(y[0])
                force = a + b * np.sin(w * t) - half * y[1] ** 2
                return [y[1], (force - (load(y) * side * self.place(y[0])[1] if pushes else 0.0)) / m]

            watched = []
            for event, way in zip([*events, lambda y: y[0] - ends], [*falling, 1]):
                function = lambda t, y, event=event, way=way: event(y) if t > begun else -way * 1e-300  # noqa: E731
                function.terminal, function.direction = True, way  # type: ignore[attr-defined]
                watched.append(function)
            return solve_ivp(
                rates, (begun, duration), state, method="DOP853", rtol=1e-12, atol=1e-14, max_step=0.005, events=watched,
                dense_output=True,
            )  # fmt: skip

        # where the load is, what ends that, which way, and what follows
        phases: dict[str, tuple[list[Callable[[Any], float]], list[int], list[str]]] = {
            "open": ([lambda y: y[0] - self.at], [1], ["pushes"]),
            "away": ([lambda y: depth(y)[0]], [1], ["pushes"]),
            "pushes": ([lambda y: depth(y)[0], load], [-1, -1], ["away", "idle"]),
            "idle": ([lambda y: depth(y)[0], load], [-1, 1], ["away", "pushes"]),
        }
        begun, state, best, left, phase = 0.0, np.array([self.start, 0.0]), (0.0, 0.0), 0, "open"
        while begun < duration and state[0] < ends:
            run = advance(phase == "pushes", *phases[phase][:2])
            if phase == "pushes":
                at = np.linspace(begun, run.t[-1], 400)
                k = int(np.argmax([load(run.sol(t)) for t in at]))
                bounds = at[max(k - 1, 0)], at[min(k + 1, len(at) - 1)]
                peak = minimize_scalar(
                    lambda t, run=run: -load(run.sol(t)), bounds=bounds, method="bounded", options={"xatol": 1e-11}
                )  # fmt: skip
                best = max(
                    best, (-float(peak.fun), float(peak.x)), (float(load(run.sol(at[k]))), float(at[k]))
                )
            begun, state = float(run.t[-1]), run.y[:, -1]
            if phase == "open":
                side = float(np.sign(self.place(state[0])[1]))
            following = [later for later, times in zip(phases[phase][2], run.t_events) if len(times)]
            left += following == ["away"]
            phase = following[0] if following else phase
        return *best, left, begun


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("held", HELD)
def test_largest_loads_of_damped_springs_beside_scipy(held: str, seed: int) -> None:
    rng = np.random.default_rng([seed, 21])
    crank, duration = Crank(held, rng), float(rng.uniform(1.0, 2.0))
    peak, when, rebounds, _ = crank.course(duration)
    for samples in (7, 203, 4001):
        summary = deploy(load_scene_text(yaml.safe_dump(crank.scene(duration, samples)))).summary
        own, load = summary["locks"]["soft"], summary["extremes"]["latch_loads.soft"]
        assert own["rebounds"] == rebounds > 0
        assert abs(own["peak_moment"] - peak) <= own["errors"]["peak_moment"] + ORACLE * peak
        assert abs(own["peak_time"] - when) <= own["errors"]["peak_time"] + 1e-7
        # the load of a spring has one sign, and jumps wherever its damper is met
        pushed, off = (
            ("smallest", "largest") if -load["smallest"] > load["largest"] else ("largest", "smallest")
        )
        assert abs(abs(load[pushed]) - peak) <= load["errors"][pushed] + ORACLE * peak
        assert abs(load[off]) <= load["errors"][off]
        assert max(load["errors"][pushed], load["errors"][off], own["errors"]["peak_moment"]) <= 1e-6 * peak


@pytest.mark.parametrize("held", HELD)
def test_a_rigid_latch_that_ends_the_motion_ends_the_growth_of_a_load(held: str) -> None:
    crank = Crank(held, np.random.default_rng(3))
    ends = crank.at + 0.05
    peak, when, _, stops = crank.course(4.0, ends)
    assert stops < 4.0
    tree = crank.scene(4.0, 41, until="all")
    tree["deploy"]["latches"].append({"name": "hard", "joint": "crank", "at": ends})
    summary = deploy(load_scene_text(yaml.safe_dump(tree))).summary
    own = summary["locks"]["soft"]
    assert summary["termination"]["time"] == summary["locks"]["hard"]["time"] and "warnings" not in summary
    assert abs(summary["termination"]["time"] - stops) <= summary["lock"]["time_error"] + 1e-10
    assert abs(own["peak_moment"] - peak) <= own["errors"]["peak_moment"] + ORACLE * peak
    assert abs(own["peak_time"] - when) <= own["errors"]["peak_time"] + 1e-7


# -- what comes to rest on a spring -----------------------------------------------------------------------------
STIFFNESS, DEPTH = 10.0, float(np.radians(10.0))


def yoke(**more: Any) -> dict[str, Any]:
    """Return a yoke that is led through 90 degrees in 4 s, where it rests, and a panel that swings on it."""
    z = {"type": "revolute", "axis": AXIS}
    joints = [
        {"name": "yoke", **z, "parent": "base"},
        {"name": "panel", **z, "origin": {"xyz": [0.6, 0, 0]}, "spring": {"stiffness": 0.8, "rest": 0.2}},
    ]
    links = [
        {"name": "y", "mass": 2.0, "com": [0.3, 0, 0], "inertia": {"zz": 0.1}},
        {"name": "p", "mass": 1.2, "com": [0.3, 0, 0], "inertia": {"zz": 0.05}},
    ]
    latch = {"name": "soft", "joint": "yoke", "at": "80 deg", "hold": {"stiffness": STIFFNESS}}
    return {
        "schema": 1, "gravity": [0, 0, 0], "robot": {"joints": joints, "links": links},
        "prescribed": {"yoke": "if(t < 4, 90 deg*(t/4)^2*(3 - 2*t/4), 90 deg)"}, "initial": {"q": {"panel": -3.0}},
        "simulate": {"duration": 7.0, "samples": 71}, "deploy": {"latches": [latch], "until": "end"}, **more,
    }  # fmt: skip


@pytest.mark.parametrize("integrator", ["auto", "gauss", "dop853", "radau9"])
@pytest.mark.parametrize("until", ["all", "end"])
def test_load_of_a_joint_that_comes_to_rest_is_largest_there(until: str, integrator: str) -> None:
    for samples in (8, 71, 1401):
        tree = yoke(simulate={"duration": 7.0, "samples": samples, "integrator": integrator})
        tree["deploy"]["until"] = until
        summary = deploy(load_scene_text(yaml.safe_dump(tree))).summary
        own = summary["locks"]["soft"]
        assert abs(own["peak_moment"] - STIFFNESS * DEPTH) <= own["errors"]["peak_moment"] + 1e-14
        assert own["peak_time"] == 4.0 and "warnings" not in summary
        assert summary["termination"]["time"] == (4.0 if until == "all" else 7.0)


def test_a_load_that_has_come_to_rest_may_grow_again() -> None:
    motion = "if(t < 4, 90 deg*(t/4)^2*(3 - 2*t/4), if(t < 5, 90 deg, 90 deg + 3 deg*(1 - cos(2*(t - 5)))))"
    summary = deploy(load_scene_text(yaml.safe_dump(yoke(prescribed={"yoke": motion})))).summary
    own = summary["locks"]["soft"]
    peak = STIFFNESS * (DEPTH + np.radians(6.0))
    assert abs(own["peak_moment"] - peak) <= own["errors"]["peak_moment"] + 1e-13
    assert abs(own["peak_time"] - (5.0 + 0.5 * np.pi)) <= own["errors"]["peak_time"] + 1e-11


def test_a_joint_may_rest_before_its_latch() -> None:
    tree = yoke()
    tree["deploy"]["latches"][0]["at"] = "95 deg"
    summary = deploy(load_scene_text(yaml.safe_dump(tree))).summary
    assert abs(summary["missed"]["soft"]["nearest"] - np.radians(5.0)) <= 1e-13


@pytest.mark.parametrize("damping", [0.0, 0.3])
def test_a_stop_that_ends_the_motion_ends_the_growth_of_a_load(damping: float) -> None:
    k, start, stop, inertia = 20.0, -1.3, 0.2, 0.5
    limits = {"lower": -3.0, "upper": stop, "stop": {"restitution": 0}}
    hinge = {
        "name": "h",
        "type": "revolute",
        "axis": AXIS,
        "spring": {"stiffness": k, "rest": 1.5},
        "limits": limits,
    }
    latch = {"name": "soft", "joint": "h", "at": 0.0, "hold": {"stiffness": STIFFNESS, "damping": damping}}
    tree = {
        "schema": 1, "gravity": [0, 0, 0],
        "robot": {"joints": [hinge], "links": [{"name": "p", "mass": 0, "inertia": {"zz": inertia}}]},
        "initial": {"q": {"h": start}}, "simulate": {"duration": 5.0, "samples": 11},
        "deploy": {"latches": [latch]},
    }  # fmt: skip
    summary = deploy(load_scene_text(yaml.safe_dump(tree))).summary
    own = summary["locks"]["soft"]
    met = lambda t, y: y[0] - stop  # noqa: E731
    met.terminal = True  # type: ignore[attr-defined]
    speed = np.sqrt(k / inertia * ((start - 1.5) ** 2 - 1.5**2))
    run = solve_ivp(
        lambda t, y: [y[1], (k * (1.5 - y[0]) - STIFFNESS * y[0] - damping * y[1]) / inertia], (0.0, 5.0), [0.0, speed],
        rtol=1e-12, atol=1e-13, events=met,
    )  # fmt: skip
    peak = max(STIFFNESS * run.y[0] + damping * run.y[1])
    assert abs(own["peak_moment"] - peak) <= own["errors"]["peak_moment"] + 1e-10
    end = own["time"] + run.t[-1]
    assert summary["termination"]["time"] == own["peak_time"] == pytest.approx(end, abs=1e-10)
