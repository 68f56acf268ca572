"""Time of a sampled controller: computed torque at 1 kHz for 10 s on a seven-joint arm, and what a function in Python
costs, beside the same law in compiled code (a weak PD about the start, without gravity).

    python benchmarks/control.py [INTEGRATOR ...] [--quick] [--json FILE]

The run alone, without building and compiling: processor time, the least of several runs.
"""

from __future__ import annotations

import re
from pathlib import Path
from time import process_time

import measure

measure.single_thread()

from robodyn_cli.motion.build import build_motion  # noqa: E402
from robodyn_cli.motion.driver import Driver  # noqa: E402
from robodyn_cli.motion.second_run import grid_of  # noqa: E402
from robodyn_cli.ready.integrable import integrable  # noqa: E402
from robodyn_cli.scene import load_scene_text  # noqa: E402
from robodyn_cli.spatial.algebra import Array  # noqa: E402
from robodyn_cli.works.in_python import controlled_by  # noqa: E402

ROOT = Path(__file__).parents[1]
DURATION, PERIOD = 10.0, 1e-3  # s
START = """
initial:
  q: {q1: 0, q2: 0.55, q3: 0, q4: -1, q5: 0, q6: 1.4, q7: 0}
  qd: {q1: 0.56, q2: 0.43, q3: 0.3, q5: 0.77, q6: 0.3, q7: 1.56}
simulate: {duration: DURATION, samples: 1001}
control: """
LAWS = {
    "computed torque": "{type: computed_torque, period: 0.001, gains: {kp: 100, kd: 20}}\n",
    "pd": "{type: pd, period: 0.001, reference: HELD, gains: {kp: 5, kd: 0.5}}\n",
    "pd in Python": "{type: python, period: 0.001}\n",
}


def scene_text(law: str, duration: float) -> str:
    """Return the arm of ``configs/seven_joint_arm.yaml`` without friction, under control."""
    text = (ROOT / "configs" / "seven_joint_arm.yaml").read_text("utf-8")
    text = re.sub(r", friction: \{.*\}\}", "}", text)
    left_out = ("friction:", "expect:", "command:")
    text = "\n".join(line for line in text.splitlines() if not line.strip().startswith(left_out))
    start = ", ".join(f"q{k + 1}: '{x}'" for k, x in enumerate((0, 0.55, 0, -1, 0, 1.4, 0)))
    held = f"{{type: joint, duration: {duration}, q: {{{start}}}}}"
    return text + (START + LAWS[law]).replace("HELD", held).replace("DURATION", f"{duration}")


class Pd:
    """PD about the start as a function in Python."""

    def __init__(self) -> None:
        self.start: Array | None = None

    def reset(self) -> None:
        self.start = None

    def __call__(self, t: float, q: Array, qd: Array) -> Array:
        if self.start is None:
            self.start = q.copy()
        return 5.0 * (self.start - q) - 0.5 * qd


def least_time(law: str, integrator: str, duration: float, runs: int) -> tuple[float, int]:
    """Return the least time of some runs [s], and their steps."""
    settings = [
        f"simulate.integrator={integrator}",
        *(["gravity=[0, 0, 0]"] if law != "computed torque" else []),
    ]
    scene = load_scene_text(scene_text(law, duration), str(ROOT / "configs" / "arm.yaml"), settings)
    if law == "pd in Python":
        scene = controlled_by(scene, Pd(), None)
    motion = build_motion(integrable(scene))
    driver = Driver.of(motion)
    times = []
    for _ in range(runs):
        driver.start(0.0, motion.start)
        begun = process_time()
        driver.run(scene.simulate.duration, grid_of(scene, motion.beginning), lambda t, x: None)
        times.append(process_time() - begun)
    measure.noted(scene.simulate.integrator, times)
    return min(times), driver.counters.steps


def main() -> None:
    parser = measure.command_line(__doc__)
    parser.add_argument("integrators", nargs="*", default=["auto", "gauss8", "dopri5"])
    options = parser.parse_args()
    duration, runs = (0.1 * DURATION, 2) if options.quick else (DURATION, 7)
    with measure.reporting(options.json) as report:
        for name in options.integrators:
            for law in LAWS:
                with report.part(f"{name}, {law}"):
                    seconds, steps = least_time(law, name, duration, runs)
                    us = 1e6 * seconds * PERIOD / duration
                    report.rows.append({"integrator": name, "law": law, "steps": steps, "us_a_sample": us})
                    print(f"{name:8} {law:16} {1e3 * seconds:7.1f} ms  {steps} steps, {us:.2f} us a sample")


if __name__ == "__main__":
    main()
