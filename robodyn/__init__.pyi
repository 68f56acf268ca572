"""The functions of robodyn with their types, written by docs/make_python_stub.py."""

from collections.abc import Callable, Mapping, Sequence
from os import PathLike
from typing import Any, TypeAlias

from robodyn_cli.cli.python import RobodynWarning as RobodynWarning
from robodyn_cli.results.report import Report as Report
from robodyn_cli.errors import CapabilityError as CapabilityError
from robodyn_cli.errors import GeometryError as GeometryError
from robodyn_cli.errors import NumericalError as NumericalError
from robodyn_cli.errors import OutputError as OutputError
from robodyn_cli.errors import ResultFileError as ResultFileError
from robodyn_cli.errors import RobodynError as RobodynError
from robodyn_cli.errors import SceneError as SceneError
from robodyn_cli.errors import SingularConfigurationError as SingularConfigurationError
from robodyn_cli.errors import StrictError as StrictError
from robodyn_cli.given.poses.inverse_kinematics import InverseKinematics as InverseKinematics
from robodyn_cli.over.batch.stored import read_result as read_result
from robodyn_cli.over.batch.stored import read_results as read_results
from robodyn_cli.over.many.mechanism import Mechanism as Mechanism
from robodyn_cli.report import draw_all as draw_all
from robodyn_cli.results.hdf5.writer import write as _write
from robodyn_cli.results.result import Result as Result
from robodyn_cli.scene.load import load_scene as load_scene
from robodyn_cli.scene.load import load_scene_text as load_scene_text
from robodyn_cli.scene.types import Scene as Scene
from robodyn_cli.torques.dynamics import ForwardDynamics as ForwardDynamics
from robodyn_cli.torques.dynamics import InverseDynamics as InverseDynamics

__version__: str
write_result = _write

_Path: TypeAlias = str | PathLike[str]
_Scene: TypeAlias = _Path | Mapping[str, Any] | Scene
_Result: TypeAlias = _Path | Result
_Overrides: TypeAlias = Mapping[str, Any] | Sequence[str] | str
_Entries: TypeAlias = Mapping[str, Any] | Sequence[str] | str
_Words: TypeAlias = Sequence[str | float] | str | float
_Progress: TypeAlias = Callable[[float, float], None]

def inverse(
    scene: _Scene,
    *,
    out: _Path | None = None,
    set: _Overrides | None = None,
    no_plots: bool = False,
    plots: _Words | None = None,
    format: str = 'png',
    style: str = 'screen',
    width: str | None = None,
    no_titles: bool = False,
    strict: bool = False,
    progress: _Progress | None = None,
) -> Result:
    """Torques that a motion needs (inverse dynamics)."""

def simulate(
    scene: _Scene,
    *,
    out: _Path | None = None,
    set: _Overrides | None = None,
    no_plots: bool = False,
    plots: _Words | None = None,
    format: str = 'png',
    style: str = 'screen',
    width: str | None = None,
    no_titles: bool = False,
    strict: bool = False,
    no_error_estimate: bool = False,
    resume: bool = False,
    controller: Any = None,
    period: Any = None,
    progress: _Progress | None = None,
) -> Result:
    """Motion that the torques give (forward dynamics)."""

def deploy(
    scene: _Scene,
    *,
    out: _Path | None = None,
    set: _Overrides | None = None,
    no_plots: bool = False,
    plots: _Words | None = None,
    format: str = 'png',
    style: str = 'screen',
    width: str | None = None,
    no_titles: bool = False,
    strict: bool = False,
    no_error_estimate: bool = False,
    progress: _Progress | None = None,
) -> Result:
    """Simulate a mechanism until it locks, by one latch or several."""

def kinematics(
    scene: _Scene,
    *,
    out: _Path | None = None,
    set: _Overrides | None = None,
    no_plots: bool = False,
    plots: _Words | None = None,
    format: str = 'png',
    style: str = 'screen',
    width: str | None = None,
    no_titles: bool = False,
    strict: bool = False,
    progress: _Progress | None = None,
) -> Result:
    """Motion without forces, mobility, transmission."""

def assemble(
    scene: _Scene,
    *,
    branches: bool = False,
    at: _Entries | None = None,
    out: _Path | None = None,
    set: _Overrides | None = None,
    no_plots: bool = False,
    plots: _Words | None = None,
    format: str = 'png',
    style: str = 'screen',
    width: str | None = None,
    no_titles: bool = False,
    strict: bool = False,
    progress: _Progress | None = None,
) -> Result:
    """Close the loops, and find the ways in which they close."""

def reach(
    scene: _Scene,
    *,
    frame: str | None = None,
    position: _Words | None = None,
    rpy: _Words | None = None,
    branch: str | None = None,
    out: _Path | None = None,
    set: _Overrides | None = None,
    no_plots: bool = False,
    plots: _Words | None = None,
    format: str = 'png',
    style: str = 'screen',
    width: str | None = None,
    no_titles: bool = False,
    strict: bool = False,
    progress: _Progress | None = None,
) -> Result:
    """Joint positions that bring a frame to a pose."""

def statics(
    scene: _Scene,
    *,
    out: _Path | None = None,
    set: _Overrides | None = None,
    no_plots: bool = False,
    plots: _Words | None = None,
    format: str = 'png',
    style: str = 'screen',
    width: str | None = None,
    no_titles: bool = False,
    strict: bool = False,
    progress: _Progress | None = None,
) -> Result:
    """Balance and its stability, or torques that hold a pose."""

def linearise(
    scene: _Scene,
    *,
    at: _Entries | None = None,
    hold: bool = False,
    along: bool = False,
    input: _Words | None = None,
    output: _Words | None = None,
    instants: _Words | None = None,
    period: float | str | None = None,
    delay: float | str | None = None,
    out: _Path | None = None,
    set: _Overrides | None = None,
    no_plots: bool = False,
    plots: _Words | None = None,
    format: str = 'png',
    style: str = 'screen',
    width: str | None = None,
    no_titles: bool = False,
    strict: bool = False,
    progress: _Progress | None = None,
) -> Result:
    """Linear model about a state or along a motion: A, B, C, D, poles, modes."""

def size(
    scene: _Scene,
    *,
    by: str = 'cost',
    margin: float | str | None = None,
    types: _Words | None = None,
    thorough: bool = False,
    out: _Path | None = None,
    set: _Overrides | None = None,
    no_plots: bool = False,
    plots: _Words | None = None,
    format: str = 'png',
    style: str = 'screen',
    width: str | None = None,
    no_titles: bool = False,
    strict: bool = False,
    progress: _Progress | None = None,
) -> Result:
    """Find the cheapest or lightest motors and gears for a motion."""

def plan(
    scene: _Scene,
    *,
    set: _Overrides | None = None,
    for_: str | None = None,
    progress: _Progress | None = None,
) -> Report:
    """What a scene needs, what is left out, and operations."""

def animate(
    result: _Result,
    *,
    file: _Path | None = None,
    speed: float | str | None = None,
    fps: float | str = 25.0,
    follow: str | None = None,
    progress: _Progress | None = None,
) -> Report:
    """Make a movie of a result, or a strip of stills."""

def cache(
    *,
    clear: bool = False,
    progress: _Progress | None = None,
) -> Report:
    """Show how much compiled code is kept, or clear it."""

def check(
    result: _Result,
    scene: _Scene | None = None,
    *,
    progress: _Progress | None = None,
) -> Report:
    """Check a result against what its scene expects."""

def compare(
    result: _Result,
    baseline: _Result,
    more: _Result | Sequence[_Result] | None = None,
    *,
    rtol: float | str = 1e-09,
    atol: float | str = 1e-12,
    figures: bool = False,
    latex: bool = False,
    csv: bool = False,
    progress: _Progress | None = None,
) -> Report:
    """Compare two results, two directories of results, or the figures of several."""

def crosscheck(
    scene: _Scene,
    *,
    with_: str,
    command: str | None = None,
    own_settings: bool = False,
    step: float | str | None = None,
    out: _Path | None = None,
    set: _Overrides | None = None,
    no_plots: bool = False,
    plots: _Words | None = None,
    format: str = 'png',
    style: str = 'screen',
    width: str | None = None,
    no_titles: bool = False,
    progress: _Progress | None = None,
) -> Result:
    """Compare a scene with Pinocchio, MuJoCo or Drake."""

def equations(
    scene: _Scene,
    *,
    latex: bool = False,
    text: bool = False,
    sympy: bool = False,
    numbers: bool = False,
    file: _Path | None = None,
    set: _Overrides | None = None,
    progress: _Progress | None = None,
) -> Report:
    """Equations of motion with the scene's names: text, LaTeX or SymPy."""

def import_(
    description: _Path,
    robot: _Path | None = None,
    *,
    package: _Entries | None = None,
    strict: bool = False,
    progress: _Progress | None = None,
) -> Report:
    """Write the robot of a URDF, SDF or MJCF file as YAML."""

def export(
    source: _Scene | _Result,
    *,
    to: str | None = None,
    out: _Path | None = None,
    c: _Path | None = None,
    loop: bool = False,
    target: str | None = None,
    fmu: _Path | None = None,
    set: _Overrides | None = None,
    key: _Entries | None = None,
    input: _Entries | None = None,
    progress: _Progress | None = None,
) -> Report:
    """Write a result as CSV, Parquet, MATLAB, NumPy files, or a robot as URDF, MJCF, SDF."""

def info(
    scene: _Scene,
    *,
    at: _Entries | None = None,
    out: _Path | None = None,
    set: _Overrides | None = None,
    no_plots: bool = False,
    plots: _Words | None = None,
    format: str = 'png',
    style: str = 'screen',
    width: str | None = None,
    no_titles: bool = False,
    progress: _Progress | None = None,
) -> Result:
    """Tree, frames, M, C, G and Jacobians at a state."""

def new(
    kind: str | None = None,
    file: _Path | None = None,
    *,
    from_: str | None = None,
    example: str | None = None,
    progress: _Progress | None = None,
) -> Report:
    """Write a commented scene to begin with."""

def plot(
    results: _Result | Sequence[_Result],
    *,
    out: _Path = 'plots',
    plots: _Words | None = None,
    format: str = 'png',
    style: str = 'screen',
    width: str | None = None,
    no_titles: bool = False,
    progress: _Progress | None = None,
) -> Report:
    """Draw stored results again, several over one another."""

def optimise(
    scene: _Scene,
    *,
    vary: _Entries | None = None,
    minimise: str | None = None,
    maximise: str | None = None,
    reach: _Entries | None = None,
    keep: _Entries | None = None,
    starts: int | None = None,
    seed: int | None = None,
    jobs: int | None = None,
    out: _Path | None = None,
    set: _Overrides | None = None,
    no_plots: bool = False,
    plots: _Words | None = None,
    format: str = 'png',
    style: str = 'screen',
    width: str | None = None,
    no_titles: bool = False,
    progress: _Progress | None = None,
) -> Result:
    """Search for values of keys: the least or largest output, or outputs at targets."""

def report(
    results: _Result | Sequence[_Result],
    *,
    file: _Path | None = None,
    live: _Entries | None = None,
    no_plan: bool = False,
    progress: _Progress | None = None,
) -> Report:
    """Write results as one page for a browser, moving drawings included."""

def run(
    scenes: _Scene | Sequence[_Scene],
    *,
    jobs: int | None = None,
    out: _Path = 'outputs',
    junit: _Path | None = None,
    markdown: _Path | None = None,
    force: bool = False,
    set: _Overrides | None = None,
    timeout: float | str | None = None,
    no_plots: bool = False,
    plots: _Words | None = None,
    format: str = 'png',
    style: str = 'screen',
    width: str | None = None,
    no_titles: bool = False,
    baseline: _Path | None = None,
    update_baseline: bool = False,
    rtol: float | str = 1e-09,
    atol: float | str = 1e-12,
    progress: _Progress | None = None,
) -> Report:
    """Run many scenes, each by its own command; check them."""

def schema(
    *,
    progress: _Progress | None = None,
) -> Report:
    """Print the JSON Schema of scenes, for editors."""

def sensitivity(
    scene: _Scene,
    *,
    to: _Words | None = None,
    of: _Words | None = None,
    jobs: int | None = None,
    out: _Path | None = None,
    set: _Overrides | None = None,
    no_plots: bool = False,
    plots: _Words | None = None,
    format: str = 'png',
    style: str = 'screen',
    width: str | None = None,
    no_titles: bool = False,
    progress: _Progress | None = None,
) -> Result:
    """Derivatives of figures of a run by numbers of its scene."""

def stability(
    scene: _Scene | None = None,
    *,
    suite: bool = False,
    quick: bool = False,
    cases: _Words | None = None,
    out: _Path | None = None,
    set: _Overrides | None = None,
    no_plots: bool = False,
    plots: _Words | None = None,
    format: str = 'png',
    style: str = 'screen',
    width: str | None = None,
    no_titles: bool = False,
    progress: _Progress | None = None,
) -> Result:
    """Stiffness, step limits, and what each method does."""

def sweep(
    scene: _Scene,
    *,
    vary: _Entries | None = None,
    n: int | None = None,
    sampler: str | None = None,
    seed: int | None = None,
    of: _Words | None = None,
    yield_: float | str | None = None,
    indices: bool = False,
    jobs: int | None = None,
    scheduler: str | None = None,
    out: _Path | None = None,
    set: _Overrides | None = None,
    no_plots: bool = False,
    plots: _Words | None = None,
    format: str = 'png',
    style: str = 'screen',
    width: str | None = None,
    no_titles: bool = False,
    progress: _Progress | None = None,
) -> Result:
    """Many runs with other values of some keys: sweeps and Monte Carlo."""

def validate(
    scenes: _Scene | Sequence[_Scene],
    *,
    set: _Overrides | None = None,
    strict: bool = False,
    progress: _Progress | None = None,
) -> Report:
    """Check scenes and list all that is wrong."""

def view(
    results: _Result | Sequence[_Result],
    *,
    live: _Entries | None = None,
    no_plan: bool = False,
    progress: _Progress | None = None,
) -> Report:
    """Open results in the browser."""

def work_precision(
    scene: _Scene,
    *,
    out: _Path | None = None,
    set: _Overrides | None = None,
    methods: _Words | None = None,
    tolerances: _Words | None = None,
    repeats: int = 7,
    no_plots: bool = False,
    plots: _Words | None = None,
    format: str = 'png',
    style: str = 'screen',
    width: str | None = None,
    no_titles: bool = False,
    progress: _Progress | None = None,
) -> Result:
    """Error against run time, for every method."""
