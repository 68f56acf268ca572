"""A short run of the proof; ``python -m tests.proof`` goes on for as long as one likes."""

from __future__ import annotations

import numpy as np
import pytest

from robodyn_cli import load_scene_text, simulate
from robodyn_cli.expr.rebuild import evaluate
from robodyn_cli.ready.prepare import prepare

pytest.importorskip("pinocchio")

from tests.proof import amplified, extended, sensitivities
from tests.proof.__main__ import BAD, words
from tests.proof.equations import Equations, Modes
from tests.proof.families import DEPLOYMENTS, FAMILIES, SECOND, THIRD, make
from tests.proof.judge import Run, dataclasses, try_seed
from tests.proof.locks import LockTruth, compare
from tests.proof.reference import Reference, UndecidedError


def line(run: Run) -> str:
    return words(dataclasses.asdict(run))


@pytest.mark.parametrize("family", range(len(FAMILIES)))
def test_no_printed_error_hides_the_true_one(family: int) -> None:
    runs = try_seed(family, 3)
    bad = [line(run) for run in runs if run.verdict in BAD]
    assert not bad, "\n".join(bad)
    assert any(run.verdict in ("ok", "rounding") for run in runs), [line(run) for run in runs]


@pytest.mark.parametrize(
    "seed", [SECOND, SECOND + 1, *range(DEPLOYMENTS + 3, DEPLOYMENTS + 7), THIRD, THIRD + 1, THIRD + 2]
)
def test_no_gear_lock_controller_or_payload_hides_its_error(seed: int) -> None:
    runs = try_seed(seed, 4)
    assert not [line(run) for run in runs if run.verdict in BAD]
    assert any(run.verdict in ("ok", "rounding") for run in runs), [line(run) for run in runs]


def test_a_lock_that_is_late_is_found() -> None:
    """The judge sees a deployment that locks at another time than it says, or does not lock."""
    true = LockTruth(2.0, 1e-13)
    assert compare({"time": 2.0 + 1e-6, "time_error": 1e-8}, true)[0] == "low"
    assert compare({"time": 2.0 + 1e-6, "time_error": 1e-6}, true)[0] == "ok"
    assert compare({"time": 2.0 + 1e-6, "time_error": 1e-4}, true)[0] == "high"
    assert (
        compare(None, true)[0] == compare({"time": 2.0, "time_error": 1e-9}, LockTruth(None))[0] == "silent"
    )


def test_reference_and_program_have_the_same_accelerations() -> None:
    """The equations from Pinocchio and by hand, and those of the program, at the start; in Python's numbers, as compiled
    code is held against the reference by the runs above.
    """
    compared = 0
    for seed in (*range(100), *range(SECOND, SECOND + 30)):
        _, m, _ = make(seed)
        if m.branch is not None or any(b.extra.get("limits") or b.extra.get("friction") for b in m.bodies):
            continue  # events at the start belong to the reference's run
        compared += 1
        setup = prepare(load_scene_text(m.scene()))
        q, v = setup.assembled.q, setup.assembled.v
        qdd = np.array(evaluate(list(setup.problem.forward.qdd), {"t": [0.0], "q": q, "v": v}))
        a, _ = Equations(m).solve(0.0, q, v, Modes(s=1e-9))
        assert np.abs(a - qdd).max() < 1e-9 * (1.0 + np.abs(a).max()), seed
    assert compared > 30


@pytest.mark.parametrize("seed", [39, 84, 93, 174, 296])
def test_scenes_that_were_wrong_once(seed: int) -> None:
    """A bounce at a sample, rests on stops, a stop left as its load vanished, a slide at rest in its dead point."""
    bad = [line(run) for run in try_seed(seed, 3) if run.verdict in (*BAD, "failed", "unconfirmed")]
    assert not bad, "\n".join(bad)


@pytest.mark.parametrize(("seed", "step"), [(250149, 0.001358), (250365, 0.00226)])
def test_a_bounce_within_a_fixed_step_is_followed(seed: int, step: float) -> None:
    """A joint leaves its stop from zero and is back within the step in which it left."""
    settings = ["simulate.integrator=implicit_midpoint", f"simulate.step={step}"]
    found = simulate(load_scene_text(make(seed)[1].scene(), overrides=settings))
    assert found.summary["error_estimate"]["state_max"] is not None, found.summary["error_estimate"]


@pytest.mark.parametrize(("seed", "runs"), [(230073, 12), (230399, 12), (250003, 12), (1001020, 8)])
def test_errors_that_both_integrations_share(seed: int, runs: int) -> None:
    """Some of these settings end where both errors are the same, or take a pulse in one and the same step."""
    bad = [line(run) for run in try_seed(seed, runs) if run.verdict in BAD]
    assert not bad, "\n".join(bad)


@pytest.mark.skipif(not extended.AVAILABLE, reason="long doubles are doubles here")
@pytest.mark.parametrize(
    ("family", "seed", "rtol"),
    [
        ("tumblers", 2, 1e-10),
        ("tumblers", 14, 1e-10),
        ("four_bars", 7, 1e-12),
        ("chains", 0, 1e-8),
        ("loops", 0, 1e-8),
    ],
)
def test_no_error_hides_where_motions_amplify_rounding(family: str, seed: int, rtol: float) -> None:
    """Both integrations had the same wrong state where rounding of constants grew; one run and many say the same, but
    for what their rounding has grown to."""
    judged = list(amplified.judge_seed(family, seed, (rtol,), many=True))
    assert len(judged) > 10 and any(one.how == "one" for one in judged)
    assert not [str(one) for one in judged if one.ratio < 0.1]
    assert all(0.5 < one.ratio < 2.0 for one in judged if one.how == "many")


@pytest.mark.parametrize("seed", [2, 3, 4, 11])
def test_exact_sensitivities_are_central_differences(seed: int) -> None:
    """Of simulations, inverse dynamics, kinematics and statics of random mechanisms by random numbers of theirs."""
    found = sensitivities.try_seed(seed)
    assert not [one for one in found if one.verdict == "differ"]
    assert any(one.verdict == "agree" for one in found)


def test_an_error_that_is_hidden_is_found() -> None:
    """The judge sees a run whose equations are not those of the reference."""
    _, m, _ = make(0)
    found = simulate(load_scene_text(m.scene()))
    m.gravity = 1.001 * m.gravity + 0.001
    ref = Reference(m, 1e-10, 1e-12, 30.0).run(found["q"][0], found["qd"][0], found.time)
    assert np.abs(ref.q - found["q"]).max() > 100.0 * found.summary["error_estimate"]["state_max"]


def test_the_reference_gives_up_rather_than_guess() -> None:
    _, m, _ = make(0)
    with pytest.raises(UndecidedError):
        Reference(m, 1e-13, 1e-15, 1e-3).run(m.q, m.v, np.linspace(0.0, m.duration, 5))
