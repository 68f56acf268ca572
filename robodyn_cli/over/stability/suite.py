"""The stability suite: every case by ``auto`` and by every method, judged against what is expected."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from robodyn_cli.errors import CapabilityError, RobodynError, of_option
from robodyn_cli.over.references import TrialReference
from robodyn_cli.over.stability.cases import CASES, Case
from robodyn_cli.over.stability.spectrum import Spectrum
from robodyn_cli.over.stability.stability import STIFF, along, at_start
from robodyn_cli.over.stability.trial import Budget, attempts, methods_tried, reference
from robodyn_cli.ready.prepare import prepare
from robodyn_cli.record import mutable_record
from robodyn_cli.results.result import Result
from robodyn_cli.scene.load import load_scene_text
from robodyn_cli.scene.types import Scene
from robodyn_cli.summaries.facts import ABSENT
from robodyn_cli.summaries.stability import CaseKeys, MethodTrial, SuiteSummary
from robodyn_cli.tools.progress import Progress, Stopwatch, counted, no_progress

FULL = (Budget(2_000_000, 3.0), Budget(5_000_000, 40.0))  # of a trial, of a reference
QUICK = (Budget(100_000, 0.3), Budget(400_000, 10.0))


@mutable_record
class Verdict:
    """What became of one case."""

    case: Case
    scene: str
    reference: TrialReference | None
    spectrum: Spectrum | None
    trials: list[MethodTrial]
    complaints: list[str]
    seconds: float

    def report(self) -> CaseKeys:
        """Return what the summary says of the case."""
        ref, spectrum = self.reference, self.spectrum
        return CaseKeys(
            name=self.case.name,
            expects=self.case.expects,
            holds=not self.complaints,
            found="; ".join(self.complaints) or "as expected",
            reference=None if ref is None else dataclasses.replace(ref.keys, ends_early=ABSENT),
            stiffness_ratio=None if spectrum is None else spectrum.stiffness_ratio,
            fastest_decay=None if spectrum is None else spectrum.fastest_decay,
            fastest_oscillation=None if spectrum is None else spectrum.fastest_oscillation,
            methods={t.method: t for t in self.trials},
            seconds=self.seconds,
            scene=self.scene,
        )


def suite(
    quick: bool = False,
    names: Sequence[str] | None = None,
    progress: Progress = no_progress,
    tell: Callable[[str], None] | None = None,
) -> Result:
    """Run the cases (by default all) and judge them.

    Parameters
    ----------
    quick : shorter scenes and smaller budgets. tell : is told of each case when it is done.

    Returns
    -------
    A Result; ``summary["cases"]`` is a list in the order of ``CASES``, ``summary["missed"]`` how many miss their
    expectation.

    Raises
    ------
    CapabilityError : a name that no case has.
    """
    known = [case.name for case in CASES]
    unknown = [name for name in names or () if name not in known]
    if unknown:
        raise of_option("--cases", f"no case {unknown[0]!r}; allowed: {', '.join(known)}", CapabilityError)
    chosen = [case for case in CASES if not names or case.name in names]
    watch = Stopwatch()
    verdicts = []
    for case in counted(chosen, progress, "cases"):
        verdicts.append(run_case(case, quick))
        if tell is not None:
            v = verdicts[-1]
            tell(f"{case.name}: {'; '.join(v.complaints) or 'as expected'} ({v.seconds:.1f} s)")
    summary = SuiteSummary(
        termination={"reason": "all cases run"},
        quick=quick,
        missed=sum(bool(v.complaints) for v in verdicts),
        methods=methods_tried(quick),
        cases=[v.report() for v in verdicts],
    )
    result = Result("stability", "Stability suite" + (", quick" if quick else ""), "ok", "")
    result.summarise(summary, seconds=watch.report())
    add_errors(result, verdicts, summary.methods)
    return result


def add_errors(result: Result, verdicts: Sequence[Verdict], methods: Sequence[str]) -> None:
    """Store the errors of all methods in all cases."""
    table = np.full((len(verdicts), len(methods)), np.nan)
    for row, v in zip(table, verdicts):
        for t in v.trials:
            if t.relative is not None:
                row[methods.index(t.method)] = t.relative
    result.add("suite/relative_error", table, names=tuple(methods))


def run_case(case: Case, quick: bool) -> Verdict:
    """Run one case by ``auto`` and every method."""
    text = case.text(quick)
    trial_budget, reference_budget = QUICK if quick else FULL
    watch = Stopwatch()
    scene = load_scene_text(text, f"{case.name}.yaml")
    ref, spectrum = None, None
    if case.stops is None:
        spectrum, stiff = _spectrum(scene)
        ref = reference(scene, reference_budget, stiff)
        if ref is not None:
            spectrum = along(prepare(scene), ref) or spectrum
    trials = attempts(scene, ref, trial_budget, methods_tried(quick))
    complaints = judge(case, trials, ref)
    return Verdict(case, text, ref, spectrum, trials, complaints, watch.report()["total"])


def _spectrum(scene: Scene) -> tuple[Spectrum | None, bool]:
    try:
        setup = prepare(scene)
    except RobodynError:
        return None, False
    spectrum = at_start(setup)
    return spectrum, spectrum is not None and spectrum.fastest_decay * scene.simulate.duration > STIFF


def judge(case: Case, trials: Sequence[MethodTrial], ref: TrialReference | None) -> list[str]:
    """Return what is not as it should be, in words."""
    complaints = []
    auto = next(t for t in trials if t.method == "auto")
    if case.stops is not None:
        if auto.failure != case.stops:
            complaints.append(f"expected {case.stops}, found {auto.failure or auto.status}")
    elif ref is None:
        complaints.append("no reference: no two runs at tight tolerance agree")
    elif auto.status != "stable":
        complaints.append(f"auto is {auto.status.replace('_', ' ')}: {auto.message or auto.relative}")
    else:
        if auto.relative is None or auto.relative > case.relative:
            complaints.append(
                f"auto's error is {auto.relative} of the range, expected at most {case.relative:.0e}"
            )
        if case.energy is not None and not (auto.energy is not None and auto.energy <= case.energy):
            complaints.append(f"auto's energy drifts by {auto.energy}, expected at most {case.energy:.0e}")
    for t in trials:
        if t.status == "inaccurate" and t.honest is False:
            complaints.append(
                f"{t.method} is wrong by {t.relative:.1e} of the range and its estimate hides it"
            )
        if t.status == "diverged" and not names_place(t):
            complaints.append(f"{t.method} breaks down without saying where: {t.message}")
    return complaints


def names_place(trial: MethodTrial) -> bool:
    """Tell whether a breakdown is told with its place."""
    return trial.failure != "NumericalError" or trial.joint is not None
