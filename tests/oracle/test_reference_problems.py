"""Published mechanisms in configs/benchmarks against values recomputed in quadruple precision (or exact).

Sources are named in the scene files. Digits are those that two independent formulations agree on; a tolerance is
what double precision, amplified along the motion, leaves at the tolerance of the scene.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
from scipy.special import ellipj, ellipk

from robodyn_cli import load_scene, simulate
from robodyn_cli.ready.prepare import prepare
from robodyn_cli.results.result import Result
from robodyn_cli.solve.closure import mechanism_size

BENCHMARKS = Path(__file__).parents[2] / "configs" / "benchmarks"
PATHS = [path for path in sorted(BENCHMARKS.glob("*.yaml")) if load_scene(path).command == "simulate"]
SCENES = [path.stem for path in PATHS]
LOOPED = [path.stem for path in PATHS if load_scene(path).loops]


@lru_cache
def result(name: str, *overrides: str) -> Result:
    return simulate(load_scene(BENCHMARKS / f"{name}.yaml", overrides))


def at(found: Result, path: str, time: float) -> np.ndarray:
    k = int(np.abs(found.time - time).argmin())
    assert abs(found.time[k] - time) < 1e-12
    return np.asarray(found[path][k])


def close(got: object, expected: object, tolerance: float) -> None:
    assert np.abs(np.asarray(got) - np.asarray(expected)).max() <= tolerance


@pytest.mark.parametrize("name", LOOPED)
def test_stays_closed_at_every_sample(name: str) -> None:
    found = result(name)
    size = mechanism_size(prepare(load_scene(BENCHMARKS / f"{name}.yaml")).problem.model)
    fastest = float(np.abs(found["qd"]).max())
    assert np.abs(found["constraints/position_residual"]).max() < 1e-12 * size
    assert np.abs(found["constraints/velocity_residual"]).max() < 1e-12 * size * fastest


@pytest.mark.parametrize("name", SCENES)
def test_energy_balances(name: str) -> None:
    """Through the bifurcations of the double four-bar rates are known to fewer digits."""
    found = result(name)
    assert found.summary["energy_drift_relative"] < (1e-5 if name == "four_bar_n2" else 1e-10)


def test_simple_pendulum() -> None:
    """sin(theta/2) = k sn(K - w0 t), k^2 = 1/2, theta from the downward vertical."""
    found = result("simple_pendulum")
    w0, k = np.sqrt(9.81), np.sqrt(0.5)
    sn, cn, _, _ = ellipj(ellipk(0.5) - w0 * found.time, 0.5)
    theta, rate = 2 * np.arcsin(k * sn), -2 * k * w0 * cn
    close(found["q"], np.column_stack([-np.sin(theta), -np.cos(theta)]), 1e-12)
    close(found["qd"], np.column_stack([-np.cos(theta) * rate, np.sin(theta) * rate]), 1e-11)
    # the bar pulls the particle with m (theta'^2 L + g cos theta)
    close(found["constraints/multipliers"][:, 0], -(rate**2 + 9.81 * np.cos(theta)), 1e-10)
    close(at(found, "points/mass", 10.0)[:2], [-0.27508746257611686, -0.961419205099125064], 1e-12)


RODS = {
    0.5: (0.4481426259320015, 1.0419628873038668, -2.4143083126482597, -5.949104936117637),
    1.0: (-1.207716238190638, -0.8143910230912963, -3.4065175329719577, -0.5160454721052089),
    2.0: (-0.08275830682057085, 0.40736207491190723, -0.9611454445459985, 11.898955053045295),
    3.0: (1.0250860122887291, 0.4957346476269754, -4.59335710547498, 1.1843208806142299),
    5.0: (1.1385437966718797, 1.2443799277502558, 4.9109500240044542, -5.424710593158876),
}  # fmt: skip


@pytest.mark.parametrize("time", RODS)
def test_double_pendulum_of_rods(time: float) -> None:
    found = result("double_pendulum_rods")
    q, qd = at(found, "q", time), at(found, "qd", time)
    close([q[0] + np.pi / 2, q.sum() + np.pi / 2, qd[0], qd.sum()], RODS[time], 1e-10)
    close(found["energy/total"], 0.0, 1e-9)


RBD = {
    0.2: (1.676328270275462437, 0.2120031833564481889, 1.543505526925583259,
          0.05675127417880011881, 0.003223397162052914514, 0.03872333883760007189),
    0.5: (1.710334452142605728, 0.2140077441106299510, 1.566686637757669957,
          0.1830903996614577697, 0.01118594120136587705, 0.1246759702095533188),
    1.0: (1.919887590652968018, 0.2296111209600359063, 1.707913636477478467,
          0.7888582651370187679, 0.06945017924165734185, 0.5243977304332027635),
    2.0: (5.303540218420233965, 1.142936307333893337, 2.016665602468915149,
          3.991220338035587632, -0.3140044395961604633, -2.955313343717855343),
    5.0: (7.623918665397723243, 0.2002505991292859872, 1.314617397746588297,
          -0.8207747675843171131, -0.009948809541590524194, -0.5540124237405468000),
    10.0: (5.421825448063430764, 1.126400202545335724, 1.922540183318305946,
           3.578071438836963403, -0.7303762818937323610, -3.051806121054809046),
}  # fmt: skip


def absolute(x: np.ndarray) -> np.ndarray:
    """Return the angles of link 1, link 2 and link 3 of a four-bar from those of its joints."""
    return np.array([x[0], x[0] + x[1], x[2]])


@pytest.mark.parametrize("time", RBD)
def test_four_bar_of_rigid_body_dynamics(time: float) -> None:
    found = result("rbd_four_bar")
    state = [*absolute(at(found, "q", time)), *absolute(at(found, "qd", time))]
    close(state, RBD[time], 1e-9 if time > 2 else 1e-12)  # the start is an unstable equilibrium, nearly


def test_start_of_the_four_bar_of_rigid_body_dynamics() -> None:
    found = result("rbd_four_bar")
    close(absolute(found["q"][0]), [1.6707963267948966, 0.21169091012994845, 1.5397303602625536], 1e-15)
    accelerations = [0.2695122062961781089, 0.01511949876533011392, 0.1839488293968956102]
    close(absolute(found["qdd"][0]), accelerations, 1e-13)
    close(found["constraints/multipliers"][0], [-0.394011370423081408, -5.00891852885712894], 1e-13)


# phi_A, omega_A, x and y of B's centre of mass, phi_B, phi_C; force of B on C
DRAKE = {
    0.0: (-1.8234765819369753, 3, 1, -3.8729833462074169, 0, -1.318116071652818,
          175.6069823904, -458.1874511973),
    0.5: (-0.6224502490880727, 1.627845495290941, 4.6009649023404312, -0.85753303391766575, 0.82904824654151088,
          0.15487956028420396, 282.9641163385, 76.30238853048),
    1.0: (-0.10692711783788059, 0.59551964285372902, 3.8912511514409846, 1.5712603726359643, 1.6137614496925392,
          1.1025334540407621, -32.03442943535, -114.7990678946),
    2.0: (-0.024439345900613392, -0.40348580792258195, 3.5936876378516239, 1.8607924979852976,
          1.7747666432423021, 1.2690977993124322, -22.82624983566, -172.9609441743),
    5.0: (-4.5163160940954051, 0.46738157711682309, -1.3888303453357472, 2.0185095236830024,
          -1.8805008398587137, -3.1700120253154958, 67.32008248171, 70.25503119687),
    10.0: (-3.3009958331864171, -2.5848809261146766, -2.6028560118800296, -0.84397515907186287,
           -0.83224638884213312, -2.5219840579951622, -125.4979000558, -93.58082878751),
}  # fmt: skip


@pytest.mark.parametrize("time", DRAKE)
def test_four_bar_of_drake(time: float) -> None:
    found = result("drake_four_bar")
    q = at(found, "q", time)
    middle = at(found, "points/middle", time)
    got = [q[0], at(found, "qd", time)[0], middle[0], middle[1], q[0] + q[1], q[2]]
    close(got, DRAKE[time][:6], 1e-11)
    close(at(found, "constraints/multipliers", time), DRAKE[time][6:], 1e-8)


# phi, phi', phi'', x3, x3', x3''
CRANK = {
    0.01: (1.1933810797420328, 100.39980756587247, -180.21084466444573,
           0.32090094320670466, -16.9135532403528, 63.129634503458401),
    0.02: (2.3150817775320278, 133.55397582480442, 5014.3163208410607,
           0.17735617056240164, -9.3682246120456791, 1475.6556186323492),
    0.05: (6.0677135220595857, 143.37049940161525, 8031.0823229155328,
           0.44481214358003648, 6.8568872912700303, -4053.7319066835012),
    0.1: (12.151150006923806, 130.20723338902903, 9069.910877004408,
          0.43108856074311309, 11.558918795572191, -2443.6425827102436),
}  # fmt: skip
FALLING = {
    0.0: (1.0471975511965977, 0, -22.348830722735886, 0.3454163456597992, 0, 3.7084005983652864),
    0.1: (0.93021239213620787, -2.4537121735163287, -29.505725620811747,
          0.36448958832499134, 0.3913427587323546, 4.2731745144206342),
    0.2: (0.48432996803247774, -7.3873035434777026, -89.560139191534791,
          0.4245049020162098, 0.75069980091362738, -0.71586888508913971),
    0.5: (-3.4384310389518986, -10.416657658398247, 101.23962155230977,
          0.15333443068307746, 0.23613283596162684, 6.2859784310277948),
    1.0: (-1.5262429328433716, 13.245343156018038, -41.870267086991263,
          0.26657430166177345, 2.0358517478009055, 7.5105096557215471),
}  # fmt: skip
FALL = (
    "gravity=[0, -9.81, 0]", "initial.q.phi=60 deg", "initial.q.psi=-85 deg", "initial.q.x3=0.34",
    "initial.qd.phi=0", "simulate.duration=1",
)  # fmt: skip


@pytest.mark.parametrize(("overrides", "time"), [*(((), t) for t in CRANK), *((FALL, t) for t in FALLING)])
def test_slider_crank(overrides: tuple[str, ...], time: float) -> None:
    found = result("slider_crank", *overrides)
    expected = np.reshape((FALLING if overrides else CRANK)[time], (2, 3))
    for path, values in zip(("q", "qd", "qdd"), expected.T):
        close(at(found, path, time)[[0, 2]], values, 2e-12 * max(1.0, float(np.abs(values).max())))


# x of the slider, angle and rate of the crank
SPATIAL = {
    0.1: (0.22636901600463621, 0.552043837936793597, 5.632093424973385185),
    0.2: (0.260545932688689316, 1.230926918453097361, 8.78069790547203591),
    0.5: (0.188748103261185954, 5.2498988425789029, 12.641666201185405025),
    1.0: (0.233764750335462145, 10.484073838524310459, 10.229888391902642155),
    2.0: (0.258304443416710324, 20.031285981100823248, 8.421894316042508469),
    3.0: (0.197728200609005595, 31.357363456384743932, 6.296237315278940532),
    4.0: (0.238945690003418701, 41.80108498642355788, 10.52697367069134395),
    5.0: (0.254650085467318630, 51.369439887930694023, 7.903679714885905779),
}  # fmt: skip


@pytest.mark.parametrize("time", SPATIAL)
def test_spatial_slider_crank(time: float) -> None:
    found = result("spatial_slider_crank")
    q = at(found, "q", time)
    close([q[1], q[0], at(found, "qd", time)[0]], SPATIAL[time], 1e-10)


def test_spatial_slider_crank_starts_as_given() -> None:
    found = result("spatial_slider_crank")
    close(
        found["qd"][0, 1], 0.24, 1e-15
    )  # the others follow: roll about x, then tilt about the arm (0, 2, -1)
    roll, tilt = found["qd"][0, 2:]
    close(roll * np.array([1, 0, 0]) + tilt * np.array([0, 2, -1]) / np.sqrt(5), [1.92, -0.96, 0.48], 1e-14)


FOUR_BAR_N2 = {
    1.0: (-1.76707447631020109, -6.80738524086944530),
    2.0: (-4.77023703451743497, -1.01896459143853679),
    5.0: (-15.08355715985858581, -6.10506755351962127),
    10.0: (-30.17980086019120378, -1.50664218084182933),
}


@pytest.mark.parametrize("time", FOUR_BAR_N2)
def test_double_four_bar(time: float) -> None:
    """It passes 10 horizontal poses, each a bifurcation, and stays a parallelogram."""
    found = result("four_bar_n2")
    q, (theta, rate) = at(found, "q", time), FOUR_BAR_N2[time]
    close(q[[0, 2, 4]], theta, 1e-7)
    close(at(found, "qd", time)[[0, 2, 4]], rate, 1e-6)
    close(at(found, "points/B0", time)[:2], [np.cos(theta), np.sin(theta)], 1e-7)
