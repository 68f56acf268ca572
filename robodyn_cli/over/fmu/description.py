"""``modelDescription.xml``, ``buildDescription.xml`` and the data of a unit of FMI 3.0."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any
from xml.sax.saxutils import quoteattr

from robodyn_cli.kernels.c99 import comment, literal, wrapped
from robodyn_cli.over.fmu.structure import FmuOutput, FmuStructure
from robodyn_cli.over.loop_c.library import LoopLibrary
from robodyn_cli.version import __version__

BUILD = """<?xml version="1.0" encoding="UTF-8"?>
<fmiBuildDescription fmiVersion="3.0">
  <BuildConfiguration modelIdentifier="{name}">
    <SourceFileSet language="C99">
{sources}
    </SourceFileSet>
    <Library name="m"/>
  </BuildConfiguration>
</fmiBuildDescription>
"""


class UnitDescription:
    """The texts that say what a unit has. token : of its sources."""

    def __init__(self, structure: FmuStructure, library: LoopLibrary, token: str) -> None:
        self.structure, self.library, self.token = structure, library, token
        self.data = library.tables.data
        self.outputs = structure.outputs

    # -- C --------------------------------------------------------------------------------------------
    @property
    def header(self) -> str:
        """The text of ``fmu_data.h``."""
        keys = self.structure.keys
        flags = ", ".join(str(int(k.key.name in self.structure.inputs)) for k in keys) or "0"
        names = ", ".join(f'"{comment(self.structure.shown(k.key.name))}"' for k in keys) or '""'
        lines = [
            "/* Numbers of this unit. */\n\n#include <math.h>\n",
            f'#define TOKEN "{self.token}"',
            f"#define KEYS {len(keys)}",
            f"#define MORE {len(self.outputs)}",
            f"#define INPUTS {len(self.structure.inputs)}",
            f"#define TIME_OF_POINTS {self.structure.time_of_points}",
            f"#define KNOWN {literal(self.library.tables.known)}",
            _table("KEY_LOW", [k.low for k in keys]),
            _table("KEY_HIGH", [k.high for k in keys]),
            f"static const char *const KEY_NAME[] = {{{names}}};",
            f"static const int KEY_INPUT[] = {{{flags}}};",
        ]
        return "\n".join(lines) + "\n"

    def build(self, sources: Iterable[str]) -> str:
        """Return ``buildDescription.xml``."""
        listed = "\n".join(f'      <SourceFile name="{name}"/>' for name in sources)
        return BUILD.format(name=self.library.name, sources=listed)

    # -- variables ------------------------------------------------------------------------------------
    def _states(self) -> list[FmuOutput]:
        return [FmuOutput(name, unit, "state") for name, unit in self.library.columns]

    @property
    def all_outputs(self) -> list[tuple[int, FmuOutput]]:
        """All real outputs with their value references."""
        first = 1 + len(self.structure.keys)
        states = self._states()
        errors = [FmuOutput(f"error.{x.name}", x.unit, "largest error so far of a state") for x in states]
        listed = [
            *states,
            *self.outputs,
            *errors,
            FmuOutput("error.time", "s", "error of the time of the end"),
        ]
        wanted = [(first + k, x) for k, x in enumerate(listed)]
        return [(r, x) for r, x in wanted if not x.name.removeprefix("error.").startswith("z.")]

    @property
    def after(self) -> int:
        """The first value reference behind the real variables."""
        return 1 + len(self.structure.keys) + 2 * self.data["size"] + len(self.outputs) + 1

    def model(self, stop: float, tolerance: float) -> str:
        """Return ``modelDescription.xml``."""
        name = self.library.name
        outputs = self.all_outputs
        variables = [
            '    <Float64 name="time" valueReference="0" causality="independent" variability="continuous" unit="s"/>'
        ]
        shown = [k for k in range(len(self.structure.keys)) if k != self.structure.time_of_points]
        variables += [self._key(k) for k in shown]
        variables += [
            f'    <Float64 name={quoteattr(x.name)} valueReference="{r}" causality="output" variability="continuous" '
            f'initial="calculated" description={quoteattr(x.meaning)}{_unit(x.unit)}/>'
            for r, x in outputs
        ]
        variables += self._discrete()
        known = [r for r, _ in outputs] + [self.after + k for k in (1, 2, 3)]
        listed = [f'    <Output valueReference="{r}"/>' for r in known]
        unknown = [f'    <InitialUnknown valueReference="{r}"/>' for r in known]
        own = [self.structure.unit_of(k["name"], k["unit"]) for k in self.data["keys"]]
        units = dict.fromkeys(["s", *own, *(x.unit for _, x in outputs)])
        return "\n".join([
            '<?xml version="1.0" encoding="UTF-8"?>',
            f'<fmiModelDescription fmiVersion="3.0" modelName={quoteattr(self.data["title"] or name)} '
            f'instantiationToken="{self.token}" generationTool="robodyn {__version__}">',
            f'  <CoSimulation modelIdentifier="{name}" canHandleVariableCommunicationStepSize="true" '
            'canGetAndSetFMUState="true" canSerializeFMUState="true"/>',
            "  <UnitDefinitions>", *(f"    <Unit name={quoteattr(u)}/>" for u in units if u not in ("", "1")),
            "  </UnitDefinitions>",
            '  <LogCategories>\n    <Category name="logStatusError"/>\n  </LogCategories>',
            f'  <DefaultExperiment startTime="0" stopTime="{stop!r}" tolerance="{tolerance!r}"/>',
            "  <ModelVariables>", *variables, "  </ModelVariables>",
            "  <ModelStructure>", *listed, *unknown, "  </ModelStructure>", "</fmiModelDescription>\n",
        ])  # fmt: skip

    def _key(self, k: int) -> str:
        key, own = self.structure.keys[k], self.data["keys"][k]
        is_input, shown = key.key.name in self.structure.inputs, self.structure.shown(key.key.name)
        kind = (
            'causality="input" variability="discrete"'
            if is_input
            else 'causality="parameter" variability="fixed"'
        )
        ends = "".join(
            f' {name}="{x!r}"' for name, x in (("min", key.low), ("max", key.high)) if math.isfinite(x)
        )
        return (
            f'    <Float64 name={quoteattr(shown)} valueReference="{1 + k}" {kind} start="{key.value!r}"{ends}'
            f"{_unit(self.structure.unit_of(key.key.name, own['unit']))}/>"
        )

    def _discrete(self) -> list[str]:
        names = ", ".join(f"{k} {event['name']}" for k, event in enumerate(self.data["events"])) or "none"
        hold = "whether outputs keep their values from the end of the motion on (a lock); else the simulation ends"
        rest = 'causality="output" variability="discrete" initial="calculated"'
        first = self.after
        return [
            f'    <Boolean name="hold" valueReference="{first}" causality="parameter" variability="fixed" '
            f'start="false" description={quoteattr(hold)}/>',
            f'    <Boolean name="ended" valueReference="{first + 1}" {rest} '
            'description="whether the motion has come to its end"/>',
            f'    <Int32 name="event" valueReference="{first + 2}" {rest} '
            f"description={quoteattr(f'the last event: {names}')}/>",
            f'    <Int32 name="events_passed" valueReference="{first + 3}" {rest} '
            'description="events that were passed"/>',
        ]


def _unit(unit: str) -> str:
    return f" unit={quoteattr(unit)}" if unit not in ("", "1") else ""


def _table(name: str, values: Sequence[Any]) -> str:
    listed = ", ".join(literal(float(x)) for x in values) or "0.0"
    return wrapped(f"static const double {name}[] = {{{listed}}};", "")
