"""Time laws from rest to rest against ruckig, which finds time-optimal motions under limits of speed, acceleration, jerk."""

from __future__ import annotations

import math

import numpy as np
import pytest

from robodyn_cli.trajectories.legs import fastest

ruckig = pytest.importorskip("ruckig")


@pytest.mark.parametrize("seed", range(40))
def test_durations_and_courses(seed: int) -> None:
    rng = np.random.default_rng(seed)
    speed, acceleration, jerk = (10.0 ** rng.uniform(-2, 2, 3)).tolist()
    jerk = math.inf if seed % 4 == 0 else jerk
    course = fastest(speed, acceleration, jerk).course
    given = ruckig.InputParameter(1)
    given.current_position, given.target_position = [0.0], [1.0]
    given.max_velocity, given.max_acceleration = [speed], [acceleration]
    if math.isfinite(jerk):
        given.max_jerk = [jerk]
    found = ruckig.Trajectory(1)
    assert ruckig.Ruckig(1).calculate(given, found) in (ruckig.Result.Working, ruckig.Result.Finished)
    assert found.duration == pytest.approx(course.duration, rel=1e-12)
    for t in np.linspace(0.0, course.duration, 21)[1:-1]:
        position, rate, _ = found.at_time(t)
        assert course([t])[0, 0] == pytest.approx(position[0], abs=1e-9)
        assert course([t], 1)[0, 0] == pytest.approx(rate[0], abs=1e-9 * course.largest(1)[0])
