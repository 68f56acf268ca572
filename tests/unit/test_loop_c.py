"""Simulations as C: rules beside numpy, runs beside those of the program, motions step by step, what is refused."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robodyn_cli.cli.app import run
from robodyn_cli.errors import CapabilityError
from robodyn_cli.kernels.as_c.words import text_beside, used_functions
from robodyn_cli.kernels.as_c.writer import write_c99
from robodyn_cli.over.c99.asked_keys import asked_key
from robodyn_cli.over.fmu.export import fmu_structure
from robodyn_cli.over.live.code import behind_python
from robodyn_cli.over.live.rules import Tape
from robodyn_cli.over.loop_c import rules
from robodyn_cli.over.loop_c.rules import CRules
from robodyn_cli.over.loop_c.structure import CStructure, structure_of, with_able_keys
from robodyn_cli.scene.load import Family
from tests.exported_c import COMPILER, compiled, needs_compiler, self_test
from tests.exported_loop import ExportedLoop
from tests.live import Ranges, disagreements, random_rows, run_many
from tests.mechanisms import CONFIGS
from tests.unit.test_live import operations

RNG = np.random.default_rng(23)
REACHED, ENDED, FAILED = 0, 1, 2
MASSES: Ranges = {"robot.links.link1.mass": (8.0, 17.0), "robot.links.link2.mass": (9.0, 15.0)}
STOP = "robot.joints.theta2.limits={lower: -0.2, upper: 0.2, stop: {stiffness: 2000.0, damping: 5.0}}"


PENDULUM = """
schema: 1
command: simulate
gravity: [0, -9.81, 0]
robot:
  convention: standard
  joints:
    - {name: swing, type: revolute, a: 0.5, alpha: 0, d: 0, friction: {viscous: 0.02, coulomb: 0.1, transition_speed: 0.02},
       limits: {lower: -100 deg, stop: {stiffness: 2000, damping: 5}}}
  links:
    - {name: rod, mass: 1.2, com: [0.25, 0, 0], com_frame: joint, inertia: {zz: 0.025}}
initial: {q: {swing: -20 deg}}
simulate: {duration: 3, samples: 301}
"""
STOPPED: Ranges = {
    "robot.joints.swing.friction.coulomb": (0.02, 0.4), "robot.joints.swing.friction.transition_speed": (0.005, 0.1),
    "robot.joints.swing.limits.stop.stiffness": (300.0, 9000.0), "robot.joints.swing.limits.stop.damping": (0.5, 30.0),
    "robot.joints.swing.limits.lower": (-1.9, -1.6), "robot.links.rod.mass": (0.6, 3.0),
}  # fmt: skip


def family_of(scene: str, overrides: Sequence[str] = ()) -> Family:
    return Family(CONFIGS / scene, list(overrides))


# -- the writer -----------------------------------------------------------------------------------------
IR = """
define i64 @count(ptr %x, ptr %out) {
entry:
  %sum = alloca double, align 8
  store double 0.0, ptr %sum, align 8
  %1 = load <4 x double>, ptr %x, align 32
  %2 = call <4 x double> @llvm.fabs.v4f64(<4 x double> %1)
  %3 = fcmp olt <4 x double> %1, <double 0.0, double 0.0, double 0.0, double 0.0>
  %4 = select <4 x i1> %3, <4 x double> %2, <4 x double> <double 1.0, double 2.0, double 3.0, double 4.0>
  %5 = shufflevector <4 x double> %4, <4 x double> %1, <4 x i32> <i32 3, i32 4, i32 1, i32 6>
  %6 = extractelement <4 x double> %5, i32 1
  %7 = insertelement <4 x double> poison, double %6, i32 0
  %8 = shufflevector <4 x double> %7, <4 x double> poison, <4 x i32> zeroinitializer
  %9 = fmul reassoc contract <4 x double> %8, %5
  store <4 x double> %9, ptr %out, align 32
  %10 = bitcast <4 x i1> %3 to i8
  %11 = zext i8 %10 to i64
  %12 = or i64 %11, 256
  %13 = call i64 @llvm.cttz.i64(i64 %12, i1 true)
  %14 = call double @llvm.vector.reduce.fadd.v4f64(double -0.0, <4 x double> %9)
  %15 = load double, ptr %sum, align 8
  %16 = fadd double %15, %14
  %17 = getelementptr double, ptr %out, i64 4
  store double %16, ptr %17, align 8
  %18 = fcmp une double %16, %16
  br i1 %18, label %other, label %end
other:
  ret i64 -1
end:
  ret i64 %13
}
"""


@needs_compiler
@pytest.mark.parametrize("flags", [(), ("-DVECTORS",)])
def test_ir_as_c_does_what_the_ir_does(flags: Sequence[str], tmp_path: Path) -> None:
    folder = tmp_path / "c"
    folder.mkdir()
    code = "#include <math.h>\n#include <stddef.h>\n#include <stdint.h>\n#include <string.h>\n"
    code += write_c99([IR], ["count"], {})
    code += "int64_t count(char *x, char *out);\nint64_t count(char *x, char *out)\n{\n    return loop_count(x, out);\n}\n"
    (folder / "a.c").write_text(code)
    library = ctypes.CDLL(str(compiled(folder, *flags, "-shared", "-fPIC")))
    library.count.restype = ctypes.c_int64
    x, out = np.array([0.5, 3.0, -2.0, -7.0]), np.zeros(5)
    first = library.count(ctypes.c_void_p(x.ctypes.data), ctypes.c_void_p(out.ctypes.data))
    chosen = np.where(x < 0, np.abs(x), [1.0, 2.0, 3.0, 4.0])
    mixed = np.array([chosen[3], x[0], chosen[1], x[2]])
    np.testing.assert_array_equal(out, [*(mixed[1] * mixed), np.sum(mixed[1] * mixed)])
    assert first == 2
    x[1] = np.nan
    x[0] = np.nan
    assert library.count(ctypes.c_void_p(x.ctypes.data), ctypes.c_void_p(out.ctypes.data)) == -1


# -- rules ----------------------------------------------------------------------------------------------
@needs_compiler
def test_all_operations_of_rules_come_out_as_those_of_numpy(tmp_path: Path) -> None:
    inputs: dict[str, Any] = {
        "x": RNG.normal(size=(3, 4)),
        "A": RNG.normal(size=(2, 3, 3)),
        "wide": RNG.normal(size=(2, 2, 4)),
    }
    inputs["x"][0, 1], inputs["x"][0, 2] = 0.625, -0.125  # halves, when they are rounded
    tape = Tape()
    recorded = operations(*(tape.input(name, RNG.normal(size=x.shape)) for name, x in inputs.items()))
    rule = {"code": tape.code, "outputs": {k: x.place for k, x in recorded.items()}}
    expected = {k: np.ravel(x).astype(float) for k, x in operations(*inputs.values()).items()}
    written = CRules({"all": rule}, {"all": (tape.examples, {})}, list(inputs), list(recorded))
    library = used_functions(text_beside(rules.__file__, "operations.c"), [written.text])
    copies = "".join(
        f"    for (k = 0; k < {x.size}; ++k)\n        *out++ = judged.{name}[k];\n"
        for name, x in expected.items()
    )
    given = ", ".join(f"{name}" for name in inputs)
    arguments = ", ".join(f"const double *{name}" for name in inputs)
    folder = tmp_path / "c"
    folder.mkdir()
    (folder / "a.c").write_text(
        f"#include <math.h>\n#include <string.h>\n{library}\n{written.text}\n"
        f"void all(double *out, double *s, {arguments});\nvoid all(double *out, double *s, {arguments})\n{{\n"
        f"    const Given given = {{{given}}};\n    Judged judged;\n    int k;\n\n"
        f"    rule_all(&given, &judged, s);\n{copies}}}\n"
    )
    code = ctypes.CDLL(str(compiled(folder, "-shared", "-fPIC")))
    out, s = np.zeros(sum(x.size for x in expected.values())), np.zeros(written.scratch["all"])
    code.all(*(ctypes.c_void_p(np.ascontiguousarray(x).ctypes.data) for x in (out, s, *inputs.values())))
    for name, known in expected.items():
        np.testing.assert_allclose(out[: known.size], known, rtol=1e-12, atol=1e-12, err_msg=name)
        out = out[known.size :]


# -- whole motions --------------------------------------------------------------------------------------
CASES: dict[str, tuple[str, Sequence[str], Ranges]] = {
    "masses and starts": ("double_pendulum.yaml", (), {**MASSES, "initial.q.theta2": (-2.0, 2.0), "initial.qd.theta1": (-2.0, 2.0)}),
    "explicit, torque": ("double_pendulum.yaml", ("simulate.integrator=dop853", "torques.theta1=2*sin(3*t)", "simulate.rtol=1e-8"), MASSES),
    "drag from rest": ("double_pendulum.yaml", ("torques.theta1=-abs(qd.theta1)*qd.theta1", "initial.qd={}"), MASSES),
    "stops on the way": ("double_pendulum.yaml", (STOP,), MASSES),
    "sampled, with delay and limits": ("controlled_arm.yaml", ("initial.q.theta2=0.1",), {"control.gains.kp": (300.0, 500.0), "initial.q.theta1": (-1.7, -1.4), "control.limit.theta2": (90.0, 160.0)}),
    "prescribed": ("double_pendulum.yaml", ("initial={q: {theta2: 0.4}}", "simulate.duration=1", "prescribed={theta1: 'if(t<0.4, -0.3*t, -0.12 - 0.3*(t - 0.4))'}"), {"robot.links.link2.mass": (9.0, 15.0)}),
    "lock of other lengths": ("four_bar_deploy.yaml", (), {"robot.joints.theta1.a": (1.2, 1.28), "initial.q.theta1": (0.008, 0.3)}),
}  # fmt: skip


@needs_compiler
@pytest.mark.parametrize("name", CASES)
def test_c_gives_what_the_program_gives(name: str, tmp_path: Path) -> None:
    """Within both stated errors and 1e-12 of the size; and never an answer where the program has none."""
    scene, overrides, ranges = CASES[name]
    family = family_of(scene, overrides)
    own = ExportedLoop(family, ranges, tmp_path / "c")
    rows = np.vstack([own.structure.row, random_rows(ranges, 6, 5)])
    runs = [own.run(row) for row in rows]
    wrong, refused = disagreements(runs, run_many(family, ranges, rows))
    assert not wrong, "\n".join(wrong)
    assert refused <= len(rows) // 2, [one.get("refused") for one in runs]


def test_keys_behind_python_are_left_out_at_once() -> None:
    """An error that names them needs no halves."""
    names = [f"robot.links.link{k}.{x}" for k in (1, 2) for x in ("mass", "com.0", "inertia.zz")]
    behind, built = set(names[1::2]), []

    class Made:
        where = "leave as C"

        def __init__(self, keys: Ranges) -> None:
            self.keys = keys
            built.append(self)

        def texts(self, target: Any) -> None:
            if found := behind & set(self.keys):
                raise behind_python(found)

    cheap = dict.fromkeys(names, (0.0, 100.0))
    made, left = with_able_keys(family_of("double_pendulum.yaml"), cheap, Made)  # type: ignore[type-var]
    assert len(built) == 3 and behind.isdisjoint(made.keys) and set(names) - behind <= set(made.keys)  # type: ignore[attr-defined]
    assert set(left) == behind and all("base inertial parameters" in why for why in left.values())


def test_keys_without_part_are_left_out_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """One error names all of them, and what a key is is looked for once: by no more than the scenes with two values."""
    family = family_of("benchmarks/adams_prismatic.yaml", ["robot.links.bar.com=[2, 1, 1]"])
    cheap = {f"robot.links.bar.com.{k}": (-np.inf, np.inf) for k in range(2)} | {
        "gravity.2": (-np.inf, np.inf)
    }
    read: list[str] = []
    built: list[Ranges] = []
    scene = Family.scene

    def counted(self: Family, overrides: Sequence[str]) -> Any:
        read.extend(overrides[:1] if len(overrides) == 1 else ())
        return scene(self, overrides)

    def build(keys: Ranges) -> CStructure:
        built.append(keys)
        return CStructure(family, keys)

    monkeypatch.setattr(Family, "scene", counted)
    made, left = with_able_keys(family, cheap, build)  # type: ignore[arg-type]
    assert {key.key.name for key in made.keys} == {"gravity.2", "initial.q.slide"}
    assert set(left) == cheap.keys() - {"gravity.2"}
    assert set(left.values()) == {"nothing in the simulation depends on it as a number"}
    assert len(built) == 3 and len(read) <= 2 * 4


@needs_compiler
def test_stops_with_friction_are_followed_in_c(tmp_path: Path) -> None:
    """Kinks that lie within rounding of a step's start or of their bracket's end, or are met so slowly that they are
    zero for many times the resolution: C has nobody to ask about them."""
    (tmp_path / "scene.yaml").write_text(PENDULUM, encoding="utf-8")
    family = Family(tmp_path / "scene.yaml", [])
    own = ExportedLoop(family, STOPPED, tmp_path / "c")
    rows = np.vstack([own.structure.row, random_rows(STOPPED, 60, 5)])
    runs = [own.run(row) for row in rows]
    assert [one["refused"] for one in runs if "refused" in one] == []
    wrong, _ = disagreements(runs, run_many(family, STOPPED, rows))
    assert not wrong, "\n".join(wrong)
    for row in rows:
        memory, _ = own.begin(row, 1)
        assert own.to(memory, 2.9)[0] == REACHED


@needs_compiler
def test_a_motion_that_fails_has_no_numbers(tmp_path: Path) -> None:
    """Under such a gravity no step is short enough."""
    ranges: Ranges = {"gravity.1": (-1e306, 0.0)}
    own = ExportedLoop(family_of("double_pendulum.yaml"), ranges, tmp_path / "c")
    row = np.array([-1e306])
    memory, why = own.begin(row)
    assert why == 0
    for time in (1.0, 2.0):
        status, x = own.to(memory, time)
        assert status == FAILED and np.isnan(x).all()
    failed = own.run(row)
    assert failed["refused"] and np.isnan(failed["numbers"]).all()


# -- step by step ---------------------------------------------------------------------------------------
@needs_compiler
def test_times_that_are_asked_for_change_nothing(tmp_path: Path) -> None:
    """On the way are stops that are met and left: events that the motion passes."""
    own = ExportedLoop(family_of("double_pendulum.yaml", [STOP]), MASSES, tmp_path / "c")
    row = own.structure.row
    often, why = own.begin(row)
    assert why == 0
    states, middle, copied = [], None, []
    for k in range(1, 301):
        status, x = own.to(often, k * 0.01)
        assert status == REACHED and own.time(often) == pytest.approx(k * 0.01)
        states.append(x)
        if k == 150:
            middle = often.copy()
    assert middle is not None
    for k in range(151, 301):
        copied.append(own.to(middle, k * 0.01)[1])
    np.testing.assert_array_equal(copied, states[150:])  # bytes of memory are all there is
    once, _ = own.begin(row)
    np.testing.assert_allclose(own.to(once, 3.0)[1], states[-1], rtol=0, atol=1e-9)
    assert own.code.own_loop_passed(ctypes.c_void_p(once.ctypes.data)) >= 2
    kept = once.copy()
    for back in (own.to(once, 1.0), own.stop(once, 2.9), own.to(once, float("nan"))):  # no motion goes back
        assert back[0] == FAILED
        np.testing.assert_array_equal(back[1], own.to(kept.copy(), 3.0)[1])
    np.testing.assert_array_equal(own.to(once, 4.0)[1], own.to(kept, 4.0)[1])
    again, _ = own.begin(row, 1)
    apart = np.abs(own.to(again, 3.0)[1] - states[-1]).max()
    assert 0.0 < apart < 1e-7


@needs_compiler
def test_values_may_change_where_a_motion_stops(tmp_path: Path) -> None:
    """A constant torque that is turned over at 0.7 s: the same motion as one with a torque that depends on time."""
    ranges: Ranges = {"torques.theta1": (-5.0, 5.0)}
    own = ExportedLoop(family_of("double_pendulum.yaml", ["torques.theta1=2.0"]), ranges, tmp_path / "c")
    loop, _ = own.begin(np.array([2.0]))
    stopped = [own.stop(loop, t) for t in (0.3, 0.7)]
    assert own.change(loop, np.array([-3.0])) == 0 and own.change(loop, np.array([9.0])) != 0
    status, x = own.stop(loop, 1.5)
    family = family_of("double_pendulum.yaml", ["torques.theta1='if(t<0.7,2,-3)'", "simulate.duration=1.5"])
    runs = run_many(family, {"robot.links.link1.mass": (1.0, 20.0)}, np.array([[12.456]]))
    assert [s for s, _ in stopped] == [REACHED, REACHED] and status == REACHED
    np.testing.assert_allclose(x[:4], [*runs.q[0], *runs.qd[0]], rtol=0, atol=1e-9)


@needs_compiler
def test_a_lock_ends_a_motion_and_stays(tmp_path: Path) -> None:
    own = ExportedLoop(
        family_of("four_bar_deploy.yaml"), {"robot.links.crank.mass": (10.0, 40.0)}, tmp_path / "c"
    )
    whole = own.run(np.array([25.0]))
    there, _ = own.begin(np.array([25.0]))
    before = whole["time"] - 0.01
    assert own.to(there, before)[0] == REACHED and own.time(there) == before
    status, x = own.to(there, 1e3)
    assert status == ENDED and own.time(there) == pytest.approx(whole["time"], abs=1e-10)
    event = own.code.own_loop_last_event(ctypes.c_void_p(there.ctypes.data))
    assert own.code.own_loop_event(event) == b"dead_point"
    np.testing.assert_allclose(x[:3], whole["q"], atol=1e-9)
    np.testing.assert_array_equal(own.to(there, 2e3)[1], x)


# -- what is refused, and the folder --------------------------------------------------------------------
@needs_compiler
def test_values_that_c_cannot_vouch_for_have_a_reason(tmp_path: Path) -> None:
    """A centre of mass that is put back onto its joint cancels: other equations."""
    overrides = ["robot.links.link2.com=[-0.583, 0, 0]", "robot.links.link2.com_frame=link"]
    ranges: Ranges = {"robot.joints.theta2.a": (0.5, 1.2), "initial.q.theta1": (-3.0, 3.0)}
    own = ExportedLoop(family_of("double_pendulum.yaml", overrides), ranges, tmp_path / "c")
    rows = np.array([[0.583, 1.0], [0.9, 1.0], [0.9, 4.0], [np.nan, 1.0]])
    assert [own.run(row).get("reason") for row in rows] == ["structure", None, "range", "range"]


def test_keys_that_cannot_be_such_leave_the_others() -> None:
    """By default: structure, an option, a number in the way, and parts of an attitude are left out, each with why."""
    free = (-np.inf, np.inf)
    cheap = {"robot.links.link1.mass": free, "robot.joints.theta1.alpha": free, "robot.links.link2.mass": (1.0, 2.0),
             "simulate.duration": free, "gravity.1": free}  # fmt: skip
    made, left = structure_of(family_of("double_pendulum.yaml"), {}, cheap)
    names = [key.key.name for key in made.keys]
    assert set(names) >= {"robot.links.link1.mass", "gravity.1", "initial.q.theta1"}
    assert set(left) == set(cheap) - set(names) and len(left) == 3
    assert "outside 1:2" in left["robot.links.link2.mass"]
    made, left = structure_of(family_of("spinning_top.yaml"), {}, {"gravity.2": free})
    starts = [name.rpartition(".")[2] for name in left]
    assert starts == ["qw", "qx", "qy", "qz"] and len(made.keys) > 1


@needs_compiler
def test_inertias_that_no_body_has_are_left_to_the_program(tmp_path: Path) -> None:
    """M = I + m c^2 of one body: at the start, and where values change on the way."""
    overrides = ["robot.links.link1.inertia.zz=0.2"]
    ranges: Ranges = {"robot.links.link1.inertia.zz": (-1e3, 1e3)}
    own = ExportedLoop(family_of("double_pendulum.yaml", overrides), ranges, tmp_path / "c")
    good, bad = np.array([0.3]), np.array([-1e3])
    assert own.run(good).get("reason") is None and own.run(bad)["reason"] == "definite"
    loop, why = own.begin(good)
    assert why == 0 and own.begin(bad)[1] == own.reasons.index("definite")
    own.stop(loop, 0.1)
    assert own.change(loop, good) == 0 and own.change(loop, bad) == own.reasons.index("definite")


@needs_compiler
def test_parameters_of_torques_are_keys_and_zero_within_ranges_is_one_value(tmp_path: Path) -> None:
    """A part of a torque that no function of the model has, beside a function of time; a damping that may vanish."""
    overrides = [
        "parameters={k: 20}", "torques.theta1=-k*theta1 + 3*sin(2*t)", "robot.joints.theta1.damper={damping: 0.5}",
        "simulate.duration=0.5",
    ]  # fmt: skip
    family = family_of("double_pendulum.yaml", overrides)
    asked = [asked_key("parameters.k=0:50"), asked_key("robot.joints.theta1.damper.damping=0:2")]
    structure, _ = fmu_structure(family, asked, [])
    ranges = {key.key.name: (key.low, key.high) for key in structure.keys}
    assert ranges == {one.name: one.ends for one in asked}
    own = ExportedLoop(family, ranges, tmp_path / "c")
    rows = np.vstack([random_rows(ranges, 3, 4), [[20.0, 1e-6], [20.0, 0.0]]])
    pages = [own.run(row) for row in rows]
    wrong, refused = disagreements(pages, run_many(family, ranges, rows))
    assert wrong == [] and refused == 1 and pages[-1]["reason"] == "special"
    source = (tmp_path / "c" / "own_loop.c").read_text()
    assert "(double)NAN" in source and "NAN" not in source.replace(
        "(double)NAN", ""
    )  # as a float it is promoted
    with pytest.raises(CapabilityError, match="parameters.unused: nothing in the simulation depends on it"):
        fmu_structure(
            family_of("double_pendulum.yaml", ["parameters={unused: 2}"]),
            [asked_key("parameters.unused=1:3")],
            [],
        )


REFUSED = {
    ("bouncing_pendulum.yaml",): "rigid stop",
    ("four_bar_prescribed.yaml",): "a motion is prescribed",
    ("cart_pole_lqr.yaml", "--key", "robot.links.rod.mass"): "its controller follows from the keys",
    ("controlled_arm.yaml", "--set", "control.sensors.noise=1e-4"): "sensors are noisy",
    ("double_pendulum.yaml", "--key", "robot.joints.theta1.alpha=-1:1"): "alpha",
    ("double_pendulum.yaml", "--key", "initial.q.theta1=1:2"): "lies outside 1:2",
    ("double_pendulum.yaml", "--set", "simulate.error_estimate=false"): "no errors are estimated",
    ("seven_joint_arm.yaml",): "a scene of inverse cannot leave as C; allowed: simulate, deploy",
}


@pytest.mark.parametrize("given", REFUSED)
def test_what_cannot_leave_is_refused_by_name(given: Sequence[str], tmp_path: Path, capsys: Any) -> None:
    scene, *options = given
    out = tmp_path / "c"
    assert run(["export", str(CONFIGS / scene), "--c", str(out), "--loop", *options]) == 2
    assert REFUSED[tuple(given)] in capsys.readouterr().err and not out.exists()


def test_the_loop_goes_with_c(tmp_path: Path, capsys: Any) -> None:
    scene = str(CONFIGS / "double_pendulum.yaml")
    assert run(["export", scene, "--loop"]) == 2
    assert "--loop goes with --c" in capsys.readouterr().err


@needs_compiler
def test_the_folder_tests_itself(tmp_path: Path) -> None:
    """With loops that are closed for other starts, with vectors, under sanitizers where there are some."""
    out = tmp_path / "c"
    assert run(["export", str(CONFIGS / "four_bar_deploy.yaml"), "--c", str(out), "--loop", "--quiet"]) == 0
    assert {path.name for path in out.glob("*.c")} == {
        "four_bar_deploy.c", "four_bar_deploy_loop.c", "self_test.c"
    }  # fmt: skip
    (tmp_path / "probe").mkdir()
    (tmp_path / "probe" / "probe.c").write_text("int main(void)\n{\n    return 0;\n}\n")
    flags = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
    try:
        compiled(tmp_path / "probe", *flags)
    except AssertionError:  # the compiler has no sanitizers
        flags = []
    told = self_test(out, "-DFOUR_BAR_DEPLOY_VECTORS", *flags)
    assert told.count("end at 1") == 3 and told.endswith("all agree\n")
    assert COMPILER and "12.28299" in (out / "README.md").read_text()
