"""A whole example and a picture for each section of the scene file."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from website.gallery import description, figure, picture, title, whole
from website.pages import Site
from website.runs import Shot

HERE = Path(__file__).parent / "examples"
# section by its anchor: command that runs the example, and the plot that shows what the section is about; sections
# that no scene of configs shows well have one in examples/
EXAMPLES = {
    "rules": ("simulate configs/double_pendulum.yaml", "mechanism"),
    "the-whole-scene": ("deploy configs/four_bar_deploy.yaml", "mechanism"),
    "robot": ("inverse configs/benchmarks/puma560.yaml", "mechanism"),
    "joints": ("inverse configs/seven_joint_arm.yaml", "mechanism"),
    "forces-in-a-joint": ("simulate configs/bouncing_pendulum.yaml", "joint_angles"),
    "links": ("simulate configs/tumbling_body.yaml", "mechanism"),
    "points-and-frames": ("inverse configs/mechanisms/five_bar_circle.yaml", "tip_path"),
    "forces-between-bodies": ("simulate configs/benchmarks/adams_tran_spring.yaml", "mechanism"),
    "payloads": ("simulate configs/catching_arm.yaml", "joint_rates"),
    "loops": ("simulate configs/benchmarks/bennett.yaml", "mechanism"),
    "couplers": ("deploy configs/mechanisms/solar_array_in_step.yaml", "mechanism"),
    "drives": ("simulate examples/drives.yaml", "joint_angles"),
    "motors-and-gears": ("inverse configs/2r_drives.yaml", "drives"),
    "margins-of-motorisation": ("inverse configs/deployable_hinge.yaml", "motorisation"),
    "control": ("simulate configs/controlled_arm.yaml", "tracking"),
    "initial-state": ("simulate configs/benchmarks/spatial_slider_crank.yaml", "mechanism"),
    "trajectories": ("inverse configs/trajectories/pick_and_place.yaml", "mechanism"),
    "inverse-kinematics": ("inverse configs/2r_circle.yaml", "mechanism"),
    "options-of-inverse": ("inverse configs/mechanisms/flywheel.yaml", "flywheel"),
    "options-of-simulate": ("simulate configs/double_pendulum.yaml", "energy_drift"),
    "options-of-deploy": ("deploy configs/mechanisms/four_bar_locked.yaml", "mechanism"),
    "options-of-kinematics": ("kinematics configs/mechanisms/kinematic_design.yaml", "curvature"),
    "options-of-statics": ("statics examples/statics.yaml", "mechanism"),
    "options-of-assemble": ("assemble examples/assemble.yaml", "branches"),
    "options-of-reach": ("reach configs/mechanisms/puma_reach.yaml", "branches"),
    "further-outputs": ("simulate configs/controlled_arm.yaml", "torques"),
    "expectations": ("simulate configs/mechanisms/crane.yaml", "mechanism"),
    "studies": ("sweep examples/studies.yaml", "study_histograms"),
    "searches": ("optimise configs/search/spring_balance.yaml", "search_path"),
    "formulas": ("simulate examples/formulas.yaml", "torques"),
    "units": ("simulate examples/units.yaml", "joint_angles"),
    "includes-and---set": ("inverse configs/arm_tilted.yaml", "mechanism"),
}
# sections that are about no one thing
WITHOUT = ("what-does-not-go-together",)


@dataclasses.dataclass(frozen=True)
class Example:
    """The example of a section."""

    shot: Shot
    plot: str

    def text(self) -> str:
        """Return it as it stands at the end of the section's page."""
        file = self.shot.file
        parts = ["## A whole example", description(file), f"```sh\nrobodyn {self.shot.words}\n```"]
        return "\n\n".join([*parts, whole(file)])

    def picture(self) -> str:
        """Return its picture, as it stands at the head of the page."""
        words = f"{title(self.shot.file)}: the [example](#a-whole-example) of this page"
        return figure(
            f"../{picture(self.shot, self.plot)}", words=words, alt=f"{self.plot}: {title(self.shot.file)}"
        )


def all_examples() -> dict[str, Example]:
    """Return the example of each section, by its anchor."""
    return {section: Example(Shot(words), plot) for section, (words, plot) in EXAMPLES.items()}


def add_examples(site: Site) -> None:
    """Add pictures and examples to the pages of the scene file; their commands have been run."""
    for section, example in all_examples().items():
        page = site.pages[f"scene/{section}.md"]
        page.below, page.after = example.picture(), example.text()
