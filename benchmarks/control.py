"""Time of a sampled controller: computed torque at 1 kHz for 10 s on a seven-joint arm.

    python benchmarks/control.py [INTEGRATOR ...]

The run alone, without building and compiling: processor time, the least of several runs.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path
from time import process_time

from robodyn_cli.run.driver.build import build_motion
from robodyn_cli.run.driver.driver import Driver
from robodyn_cli.run.driver.second_run import grid_of
from robodyn_cli.scene import load_scene_text

ROOT = Path(__file__).parents[1]
RUNS = 7
CONTROL = """
initial:
  q: {q1: 0, q2: 0.55, q3: 0, q4: -1, q5: 0, q6: 1.4, q7: 0}
  qd: {q1: 0.56, q2: 0.43, q3: 0.3, q5: 0.77, q6: 0.3, q7: 1.56}
control: {type: computed_torque, period: 0.001, gains: {kp: 100, kd: 20}}
simulate: {duration: 10, samples: 1001}
"""


def scene_text() -> str:
    """Return the arm of ``configs/seven_joint_arm.yaml`` without friction, under control."""
    text = (ROOT / "configs" / "seven_joint_arm.yaml").read_text("utf-8")
    text = re.sub(r", friction: \{.*\}\}", "}", text)
    left_out = ("friction:", "expect:", "command:")
    text = "\n".join(line for line in text.splitlines() if not line.strip().startswith(left_out))
    return text + CONTROL


def least_time(integrator: str) -> tuple[float, int]:
    """Return the time of a run [s], and its steps."""
    scene = load_scene_text(
        scene_text(), str(ROOT / "configs" / "arm.yaml"), [f"simulate.integrator={integrator}"]
    )
    motion = build_motion(scene)
    driver = Driver.of(motion)
    times = []
    for _ in range(RUNS):
        driver.start(0.0, motion.start)
        begun = process_time()
        driver.run(scene.simulate.duration, grid_of(scene, motion.beginning), lambda t, x: None)
        times.append(process_time() - begun)
    return min(times), driver.counters.steps


if __name__ == "__main__":
    for name in sys.argv[1:] or ("auto", "gauss8", "dopri5"):
        seconds, steps = least_time(name)
        print(f"{name:8} {1e3 * seconds:7.1f} ms  {steps} steps, {1e6 * seconds / 10_000:.2f} us a sample")
