"""Draw the pictures of docs/motions.md and print its table of figures: motions of joints, and of a frame.

python docs/make_motions.py
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from robodyn_cli.scene import load_scene_text

IMAGES = Path(__file__).parent / "images"
SCENE = """\
schema: 1
gravity: [0, 0, 0]
robot:
  joints:
    - {name: a, type: revolute, axis: [0, 0, 1], limits: {speed: 2, acceleration: 6, jerk: 60}}
    - {name: b, type: revolute, axis: [0, 0, 1], limits: {speed: 2, acceleration: 6, jerk: 60}}
  links: [{name: one, mass: 1}, {name: two, mass: 1}]
"""
STOPS = "[{q: {a: 0, b: 0}}, {q: {a: 1.2, b: 0}}, {q: {a: 1.2, b: 1}}]"
STEPS = ((0.0, 0.0), (0.5, 0.0), (0.7, 1.0), (1.3, 1.0), (1.6, 0.4), (2.0, 0.4))
STEP_POINTS = "[" + ", ".join(f"{{t: {t}, q: {{a: {x}, b: 0}}}}" for t, x in STEPS) + "]"
LAWS = {
    "trapezoid": f"{{type: trapezoid, points: {STOPS}}}",
    "s_curve": f"{{type: s_curve, points: {STOPS}}}",
    "s_curve, blend: 1": f"{{type: s_curve, blend: 1, points: {STOPS}}}",
}
SPLINES = {kind: f"{{type: {kind}, points: {STEP_POINTS}}}" for kind in ("quintic", "cubic", "monotone")}
SERIES = {
    "fourier": "{type: fourier, period: 4, duration: 4, offset: {a: 0, b: 0}, "
    "sine: [{a: 0.3}, {a: 0.2}, {a: -0.1}], cosine: [{a: -0.2}, {a: 0.2}]}"
}
PATHS = {
    name: "{type: path, point: tip, speed: 0.5, acceleration: 2, jerk: 30, angular_speed: 6, angular_acceleration: 60, "
    "angular_jerk: 800, start: {position: [0, 0, 0], orientation: {}}, segments: ["
    f"{{type: line, to: [0, 0.3, 0]{blend}}}, "
    f"{{type: line, to: [0.6, 0.3, 0], orientation: {{rpy: [0, 0, 180 deg]}}{blend}}}, "
    "{type: line, to: [0.6, 0, 0]}, {type: arc, via: [0.3, -0.1, 0], to: [0, 0, 0], orientation: {rpy: [0, 0, 0]}}]}"
    for name, blend in (("stops", ""), ("blend: 0.1", ", blend: 0.1"))
}
ROWS = ("position", "rate", "acceleration", "jerk")
STYLES = ("-", "--", ":")


def sampled(text: str) -> tuple[Any, list[Any]]:
    """Return times, and positions, rates, accelerations (T, 2) of a motion, and the jerk where it is bounded."""
    motion = load_scene_text(f"{SCENE}trajectory: {text}").trajectory
    times = np.linspace(0.0, motion.duration, 4001)
    found = motion.motion(times, ("a", "b"), {})
    jerk = motion.course(times, 3) if motion.type == "s_curve" else np.full_like(found.q, np.nan)
    return times, [found.q, found.qd, found.qdd, jerk]


def draw(name: str, laws: dict[str, str], rows: int, joints: tuple[int, ...]) -> None:
    """Write a picture with a column for each law and a row for each derivative."""
    figure, axes = plt.subplots(
        rows,
        len(laws),
        figsize=(3.1 * len(laws) + 0.6, 1.45 * rows + 0.5),
        sharex="col",
        sharey="row",
        squeeze=False,
    )
    for column, (title, text) in enumerate(laws.items()):
        times, found = sampled(text)
        axes[0, column].set_title(title, fontsize=10)
        axes[-1, column].set_xlabel("t [s]")
        for row in range(rows):
            ax = axes[row, column]
            for k in joints:
                ax.plot(times, found[row][:, k], STYLES[k], color=f"C{k}", lw=1.3, label=f"joint {'ab'[k]}")
            if laws is SPLINES and row == 0:
                ax.plot(*zip(*STEPS), "o", color="black", ms=3.5)
            if np.isnan(found[row]).all():
                ax.text(0.5, 0.5, "not bounded", transform=ax.transAxes, ha="center", va="center", fontsize=9)
            ax.grid(alpha=0.3)
            if column == 0:
                ax.set_ylabel(ROWS[row] + f"\n[rad{('', '/s', '/s²', '/s³')[row]}]", fontsize=8)
    if len(joints) > 1:
        axes[0, 0].legend(fontsize=8, loc="upper left")
    figure.tight_layout()
    figure.savefig(IMAGES / name, dpi=80)
    plt.close(figure)


def draw_paths(name: str) -> None:
    """Write a picture of the paths of a frame: from above with its x axes, its speed and its acceleration over time."""
    figure, axes = plt.subplots(1, 3, figsize=(10.5, 3.1))
    for k, (title, text) in enumerate(PATHS.items()):
        scene = f"{SCENE}  points: {{tip: {{link: two, at: [0, 0, 0]}}}}\ntrajectory: {text}"
        motion = load_scene_text(scene).trajectory
        times = np.linspace(0.0, motion.duration, 4001)
        found = motion.target(times, {})
        axes[0].plot(*found.p[:, :2].T, STYLES[k], color=f"C{k}", lw=1.3, label=title)
        if k:
            few = motion.target(np.linspace(0.0, motion.duration, 37), {})
            axes[0].quiver(*few.p[:, :2].T, *few.R[:, :2, 0].T, color="0.5", width=0.004, scale=14)
        axes[1].plot(times, np.linalg.norm(found.pd, axis=1), STYLES[k], color=f"C{k}", lw=1.3)
        axes[2].plot(times, np.linalg.norm(found.pdd, axis=1), STYLES[k], color=f"C{k}", lw=1.3)
    for ax, x, y in zip(axes, ("x [m]", "t [s]", "t [s]"), ("y [m]", "speed [m/s]", "acceleration [m/s²]")):
        ax.set_xlabel(x, fontsize=9)
        ax.set_ylabel(y, fontsize=9)
        ax.grid(alpha=0.3)
    axes[0].set_aspect("equal", adjustable="datalim")
    axes[0].legend(fontsize=8, loc="center")
    figure.tight_layout()
    figure.savefig(IMAGES / name, dpi=80)
    plt.close(figure)


def main() -> None:
    draw("motions_stops.png", LAWS, 4, (0, 1))
    draw("motions_way_points.png", SPLINES, 3, (0,))
    draw("motions_fourier.png", SERIES, 3, (0,))
    draw_paths("motions_path.png")
    print(
        "| motion | duration [s] | peak rate [rad/s] | peak acceleration [rad/s²] | beyond the way points [rad] |"
    )
    print("|---|---|---|---|---|")
    for title, text in {**LAWS, **SPLINES}.items():
        times, (q, qd, qdd, _) = sampled(text)
        beyond = max(0.0, q[:, 0].max() - (1.2 if title in LAWS else 1.0), -q[:, 0].min())
        figures = (times[-1], np.abs(qd).max(), np.abs(qdd).max())
        print(f"| `{title}` | {' | '.join(f'{x:.3f}' for x in figures)} | {beyond:.3f} |")


if __name__ == "__main__":
    main()
