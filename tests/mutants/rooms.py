"""The modules that make figures, and the tests of each: a mutant is to be caught by the quick ones of its room."""

from __future__ import annotations

from pathlib import Path

from tests.mutants.listed import PACKAGE

DRIVES = [
    "test_drive_figures.py",
    "test_units.py",
    "test_motors.py",
    "test_sizing.py",
    "test_gears.py",
    "test_extremes.py",
]
INVERSE = [
    "test_observed_figures.py",
    "test_units.py",
    "test_run_inverse.py", "test_run_inverse_closed.py", "test_inverse_at_rest.py", "test_mechanism_inverse.py",
    "test_inverse_meets_simulation.py", "test_half_turns.py", "test_payloads.py", "test_extremes.py",
]  # fmt: skip
MOTION = [
    "test_observed_figures.py",
    "test_error_rules.py",
    "test_error_estimate.py", "test_growth_of_errors.py", "test_errors_of_many.py", "test_self_check.py", "test_stiffness.py",
    "test_run_simulate.py", "test_run_simulate_loops.py", "test_driver.py", "test_model_rounding.py", "test_not_finite.py", "test_control.py",
]  # fmt: skip
OBSERVE = [
    "test_error_rules.py",
    "test_units.py",
    "test_run_reactions.py", "test_reactions.py", "test_rounding.py", "test_beyond_limits.py", "test_drawn_limits.py",
    "test_control.py", "test_control_loops.py", "test_redundant_loops.py", "test_run_simulate.py", "test_run_inverse.py",
    "test_run_simulate_loops.py", "test_poses.py", "test_overconstrained.py", "test_observed_figures.py",
    "test_not_finite.py", "test_rolled_simulation.py", "test_run_deploy.py", "test_modes.py", "test_orientations.py",
]  # fmt: skip
RESULTS = [
    "test_results_compare.py", "test_report_plots.py", "test_page.py", "test_numbers.py", "test_notebook.py",
    "test_summaries.py", "test_expect.py", "test_docs.py", "test_datasets.py", "test_drives_page.py", "test_not_finite.py",
]  # fmt: skip
STUDY = [
    "test_error_rules.py",
    "test_study_figures.py",
    "test_sweep.py",
    "test_study_blocks.py",
    "test_study_cluster.py",
]

DESIGN = ["test_design.py", "test_balance.py"]

# by module or package below ``robodyn_cli``: the longest name that fits counts
ROOMS = {
    "drives": DRIVES,
    "motors/gear.py": DRIVES,
    "motors/electric.py": DRIVES,
    "motors/heat.py": DRIVES,
    "works/size": DRIVES,
    "observe": OBSERVE,
    "observe/plane.py": DESIGN,
    "solve/four_bar.py": DESIGN,
    "solve/crossings.py": DESIGN,
    "works/design.py": DESIGN,
    "works/four_bars.py": DESIGN,
    "works/balance.py": DESIGN,
    "given/motion.py": ["test_extremes.py", "test_pieces.py", *INVERSE],
    "torques/checks.py": ["test_error_rules.py", *INVERSE],
    "solve/extremes.py": ["test_extremes.py", "test_error_rules.py", *DRIVES, "test_run_inverse.py"],
    "solve/quadrature.py": ["test_extremes.py", "test_error_rules.py", *DRIVES, "test_run_inverse.py"],
    "motion/contact/latches.py": ["test_latches.py"],
    "motion/contact/latch_states.py": ["test_latches.py"],
    "motion/contact/events.py": ["test_latches.py"],
    "motion/error.py": MOTION,
    "motion/second_run.py": MOTION,
    "motion/between/extremes.py": ["test_run_extremes.py"],
    "motion/between/samples.py": ["test_run_extremes.py", "test_drives_of_long_runs.py"],
    "drives/rivals.py": ["test_drives_of_long_runs.py"],
    "algorithms/polynomials.py": ["test_drives_of_long_runs.py", "test_extremes.py"],
    "observe/columns.py": ["test_run_extremes.py"],
    "solve/peaks.py": ["test_run_extremes.py"],
    "motion/self_check.py": MOTION,
    "motion/conditioning.py": MOTION,
    "over/many/inverse.py": ["test_mechanism_inverse.py", "test_mechanism.py", "test_study_blocks.py"],
    "over/many/integrate.py": ["test_error_rules.py", "test_errors_of_many.py", "test_observed_figures.py", "test_mechanism.py", "test_study_blocks.py"],
    "over/many/course.py": ["test_compiled_figures.py", "test_error_rules.py", "test_errors_of_many.py"],
    "over/sensitivity/motion/latched.py": ["test_sensitivity_latches.py"],
    "over/many/simulate.py": ["test_errors_of_many.py", "test_observed_figures.py", "test_mechanism.py", "test_study_blocks.py"],
    "over/many/latched.py": ["test_latched_many.py"],
    "over/many/rest/statics.py": ["test_many_statics.py"],
    "solve/closing/balance.py": ["test_run_statics.py", "test_many_statics.py"],
    "over/many/closings.py": ["test_closings.py", "test_latched_many.py"],
    "over/many/kinematics.py": ["test_many_kinematics.py"],
    "over/many/guides.py": ["test_many_kinematics.py", "test_mechanism_inverse.py"],
    "over/many/torques.py": ["test_mechanism_inverse.py", "test_many_burdens.py", "test_mechanism.py", "test_study_blocks.py"],
    "trajectories/course.py": ["test_many_kinematics.py", "test_trajectories.py"],
    "works/kinematic_figures.py": ["test_run_kinematics.py", "test_many_kinematics.py", "test_observed_figures.py"],
    "over/live": ["test_live.py", "test_live_inverse.py", "test_loop_c.py", "test_fmu.py"],
    "over/c99": ["test_c99.py", "test_written_keys.py", "test_export_c.py", "test_loop_c.py"],
    "over/loop_c": ["test_loop_c.py", "test_fmu.py"],
    "over/fmu": ["test_fmu.py"],
    "kernels/as_c": ["test_loop_c.py"],
    "kernels/from_c": ["test_from_c.py"],
    "solve/closing/together.py": ["test_rough_starts.py", "test_mechanism.py", "test_many_statics.py"],
    "over/search": ["test_search.py", "test_search_differences.py"],
    "over/sensitivity": ["test_error_rules.py", "test_sensitivity.py", "test_sensitivity_direct.py", "test_sensitivity_overconstrained.py", "test_slopes.py"],
    "over/study/design.py": STUDY,
    "over/study/report.py": STUDY,
    "over/study/rows.py": STUDY,
    "results/stated_errors.py": RESULTS,
    "results/compare.py": RESULTS,
    "summaries": ["test_observed_figures.py", *RESULTS, "test_run_reactions.py", "test_sweep.py"],
    "works/equilibria.py": ["test_run_statics.py", "test_observed_figures.py", "test_run_reactions.py", "test_stops.py", "test_limits.py"],
    "works/rest": ["test_rest_errors.py", "test_many_statics.py"],
    "works/reach.py": ["test_pose_errors.py", "test_figures.py"],
    "works/closed_branches.py": ["test_closed_errors.py", "test_run_assemble.py"],
    "works/linearise/errors.py": ["test_closed_errors.py", "test_rest_errors.py"],
    "ready/closed_errors.py": ["test_closed_errors.py", "test_rest_errors.py", "test_pose_errors.py"],
    "works/statics.py": ["test_run_statics.py", "test_observed_figures.py", "test_run_reactions.py", "test_stops.py", "test_limits.py"],
    "works/kinematics.py": ["test_observed_figures.py", "test_run_kinematics.py", "test_units.py", "test_poses.py", "test_many_kinematics.py"],
}  # fmt: skip


def files() -> list[Path]:
    """Return the modules that make figures."""
    found = [
        path
        for name in ROOMS
        for path in ([PACKAGE / name] if name.endswith(".py") else (PACKAGE / name).rglob("*.py"))
    ]
    return sorted(path for path in set(found) if path.name != "__init__.py")


def room_of(file: str) -> list[str]:
    """Return the names of the tests of a module."""
    fits = [name for name in ROOMS if file == name or file.startswith(name + "/")]
    return ROOMS[max(fits, key=len)]


def tests(mutated: set[str]) -> list[str]:
    """Return the files of the tests of some modules."""
    names = {name for file in mutated for name in room_of(file)}
    return sorted(str(path) for path in Path(__file__).parents[1].rglob("test_*.py") if path.name in names)
