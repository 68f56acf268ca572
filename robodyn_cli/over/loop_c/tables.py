"""Data of a structure as C: sizes, tables, runs, and the types of memory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from robodyn_cli.kernels.c99 import comment, identifier, literal, wrapped
from robodyn_cli.over.live.structure import COUNTS
from robodyn_cli.over.loop_c.rules import CRules, double, rule_name
from robodyn_cli.over.loop_c.structure import CStructure

ROW = 8  # bytes of a double
SLOTS = ("T", "T_END", "T_AFTER", "T_BEFORE", "NEXT_UPDATE", "H_MAX", "SAMPLE_START", "SAMPLE_STEP")
# what is kept of a motion that goes step by step
STATE = (
    "LAST_EVENT",
    "EVENT_TIME",
    "AT_EVENT",
    "ENDED",
    "TIME",
    "PASSED",
    "LIMIT",
    "LONGEST",
    "STRETCH",
    "SAMPLED",
)
FOREVER = 1e300  # s
MORE_COUNTS = ("CAPACITY", "ROWS", "WATCH")


class LoopTables:
    """The tables of a structure. own : how names of the library begin."""

    def __init__(self, structure: CStructure, own: str) -> None:
        self.structure, self.own = structure, own
        self.data = structure.data()
        self.rules = CRules(self.data["rules"], structure.judging.examples)

    @property
    def seconds(self) -> list[Mapping[str, Any]]:
        return list(self.data["second"])

    @property
    def thirds(self) -> list[Mapping[str, Any]]:
        return list(self.data.get("third", []))

    @cached_property
    def samples(self) -> int:
        """Samples of a run, at most."""
        return max(1, int(self.data["first"]["n"][self.data["counts"]["LAST_SAMPLE"]]), self.shown)

    @property
    def equations(self) -> list[str]:
        """The equations that runs ask for."""
        sizes = self.constants
        asked = {"loops": "CLOSING", "energies": "BALANCE", "psi": "LOCKS", "jacobian": "SLOW", "inertia": "DEFINITE",
                 "begun": "BEGUN", "outputs": "OBSERVED", "reactions": "REACTIONS"}  # fmt: skip
        return [name for name in self.data["outputs"] if sizes[asked[name]]]

    @property
    def shown(self) -> int:
        return int(self.data["shown"])

    @property
    def key_room(self) -> int:
        return max(1, len(self.data["keys"]))

    # -- sizes ----------------------------------------------------------------------------------------
    @cached_property
    def constants(self) -> dict[str, int]:
        """Sizes and places, by name."""
        from robodyn_cli.integrators.runtime.memory import DoubleSlot, IntegerSlot

        d, memory = self.data, self.data["memory"]
        loops, rules = d["outputs"].get("loops", {}), d["rules"]
        closing = d["start"]["closing"] or {}
        sizes = {
            "NX": d["size"], "NQ": len(d["q"]["names"]), "NV": len(d["v"]["names"]), "KEYS": len(d["keys"]),
            "EVENTS": len(d["events"]), "OWN": d["own"], "BLOCK": memory["block"], "W_COUNT": memory["w"],
            "N_COUNT": len(d["first"]["n"]), "SAMPLES": self.samples, "SHOWN": self.shown, "EVERY": d.get("every", 1),
            "SPECIALS": len(self._specials), "REASONS": len(d["reasons"]) + 1, "PASSING": d["passing"],
            "WORK": -1 if d["work"] is None else d["work"], "ARMED": DoubleSlot.SIZE,
            "SECONDS": len(self.seconds), "THIRDS": len(self.thirds),
            "PLACES": len(memory["places"]), "JOBS": len(memory["job"]),
            "CLOSING": int(bool(closing)), "MISSING": int("step.missing" in rules), "FREE": int("step.free" in rules),
            "BESIDE": int("beside" in rules), "BALANCE": int("balance" in rules), "SLOW": int("slow" in rules),
            "DEFINITE": int("definite" in rules), "MASS": d["outputs"].get("inertia", {}).get("mass", 0),
            "BEGUN": d["outputs"].get("begun", {}).get("z", 0), "FIRST_BEGUN": d["begun"],
            "UPDATES": len(memory["updates"]), "STRETCHES": len(memory["stretches"]) // 3,
            "LOCKS": int(d["locks"]), "OBSERVED": sum(d["outputs"].get("outputs", {}).values()),
            "REACTIONS": sum(d["outputs"].get("reactions", {}).values()),
        }  # fmt: skip
        sizes |= {f"AT_{name.upper()}": place for name, place in memory["parts"].items()}
        if closing:
            sizes |= {"ETA": loops["eta"], "PSI": loops["psi"], "COSINES": loops["cosines"]}
            sizes["STAGES"] = len(closing["stages"])
            sizes |= {name: int(closing[name]) for name in ("ITERATIONS", "HALVINGS", "PATIENT")}
        sizes |= {f"PLACE_{name}": k for k, name in enumerate(memory["places"])}
        sizes |= {f"JOB_{identifier(name)}": k for k, name in enumerate(memory["job"])}
        sizes |= {f"SLOT_{name}": int(getattr(DoubleSlot, name)) for name in SLOTS}
        sizes |= {f"COUNT_{name}": int(getattr(IntegerSlot, name)) for name in (*COUNTS, *MORE_COUNTS)}
        sizes |= {f"STATUS_{name}": value for name, value in d["status"].items()}
        sizes |= {f"LOCATION_{name}": value for name, value in d["location"].items()}
        sizes |= {f"REASON_{identifier(name)}": k + 1 for k, name in enumerate(d["reasons"])}
        return sizes

    @cached_property
    def _specials(self) -> list[tuple[int, float]]:
        return [(k, x) for k, key in enumerate(self.data["keys"]) for x in key["special"]]

    @cached_property
    def integration(self) -> dict[str, int]:
        """The arrays of one integration, with their doubles."""
        memory, d = self.data["memory"], self.data
        events = len(d["events"])
        room = {name: -(-size // ROW) + 1 for name, size in memory["fixed"].items()}
        closing = [size for name, size in self.rules.scratch.items() if not name.startswith("errors")]
        outputs = [sum(sizes.values()) for sizes in d["outputs"].values()]
        block = memory["block"] // ROW
        more = self.constants["OBSERVED"] + self.constants["REACTIONS"]
        before = {"before": block} if self.constants["BEGUN"] else {}
        observed = {"observed": d["size"] + 1 + more} if more else {}
        return {
            "block": block, "saved": block, **room, "numbers": d["own"] + 1,
            "p": max(1, len(memory["parameters"])), "values": events + 1, "bracket": 2 * (1 + events),
            "places": len(memory["places"]), "table": max(1, len(d["numbers"])), "x": d["size"], "out": d["size"],
            "results": max([1, *outputs]), "closing": max([1, *closing]), "state": len(STATE), **before, **observed,
        }  # fmt: skip

    @cached_property
    def judging(self) -> dict[str, int]:
        """The arrays of whole runs beside those of an integration."""
        d, nx = self.data, self.data["size"]
        out = nx * self.samples
        own = {
            "clear": d["memory"]["block"] // ROW, "w": d["memory"]["w"], "n": len(d["first"]["n"]), "y": nx,
            "p": max(1, len(d["memory"]["parameters"])), "numbers": d["own"] + 1, "job": len(d["memory"]["job"]),
            "stop": 1, "first_out": out, "again_out": 1 if d["locks"] else out,
            "scratch": max(self.rules.scratch.values()),
        }  # fmt: skip
        return own | ({"third_out": out} if self.thirds else {})

    # -- text -----------------------------------------------------------------------------------------
    @property
    def text(self) -> str:
        """Constants, types, tables and rules."""
        pieces = [f"#define {name} {value}" for name, value in self.constants.items()]
        closing = self.data["start"]["closing"]
        if closing:
            pieces += [f"#define {name} {literal(closing[name])}" for name in ("TINY", "CLOSED")]
        pieces.append(f"#define KNOWN {literal(self.known)} /* s: of what depends on time */")
        pieces += [*(f"#define {name} {k}" for k, name in enumerate(STATE)), ""]
        return "\n".join([*pieces, self._types(), self._tables()])

    @property
    def known(self) -> float:
        """Up to when all times are known at which steps have to end, and what a controller follows [s]."""
        control = self.structure.motion.problem.control
        follows = control is not None and control.reference.motion is not None and not self.structure.is_led
        return float(self.data["duration"]) if follows or self.structure.system.breakpoints else FOREVER

    def _types(self) -> str:
        def struct(name: str, first: str, arrays: Mapping[str, int]) -> str:
            listed = "\n".join(f"    double {key}[{count}];" for key, count in arrays.items())
            return f"typedef struct {{\n{first}{listed}\n}} {name};\n"

        own = self.own
        checks = (
            f"typedef char integration_fits[sizeof(Integration) <= sizeof({own}_loop) ? 1 : -1];\n"
            f"typedef char judging_fits[sizeof(Judging) <= sizeof({own}_loop_room) ? 1 : -1];\n"
        )
        judging = struct("Judging", "    Integration run;\n", self.judging)
        return struct("Integration", "", self.integration) + "\n" + judging + "\n" + checks

    def _tables(self) -> str:
        d, own = self.data, self.data["start"]["own"]
        texts = [
            _doubles("NUMBERS", d["numbers"]), _doubles("PARAMETER", d["memory"]["parameters"]),
            _doubles("UPDATE", d["memory"]["updates"]), _doubles("STRETCH_END", d["memory"]["stretches"]),
            _integers("OFF[2]", [d["off"][1], d["off"][2]], "signed char"),
            _integers("Q_PLACE", d["q"]["places"], "int"), _integers("V_PLACE", d["v"]["places"], "int"),
            _doubles("START", self._state(own["q"], own["v"])),
            _doubles("GIVEN", self._state(d["start"]["q"], d["start"]["v"])),
        ]  # fmt: skip
        if d["start"]["closing"]:
            texts += self._closing(d["start"]["closing"])
        texts += [self._keys(), self._events(), self._reasons()]
        return "\n".join(texts) + "\n"

    def _closing(self, closing: Mapping[str, Any]) -> list[str]:
        """Return which rows are lengths, and where closing starts, in parts of lengths: rows of all coordinates."""
        rows: list[float] = []
        ends: list[int] = []
        for stage in closing["stages"]:
            parts = np.zeros((stage["starts"], len(self.data["v"]["names"])))
            parts[:, stage["columns"]] = np.reshape(stage["parts"], (stage["starts"], -1))
            rows += parts.ravel().tolist()
            ends.append(stage["starts"] + (ends[-1] if ends else 0))
        return [
            _integers("LONG", closing["long"], "int"), _integers("STAGE_END", ends, "int"), _doubles("PART", rows),
        ]  # fmt: skip

    def _state(self, q: Sequence[float], v: Sequence[float]) -> list[float]:
        x = list(map(float, self.structure.motion.start))
        for places, values in ((self.data["q"]["places"], q), (self.data["v"]["places"], v)):
            for place, value in zip(places, values):
                x[place] = float(value)
        return x

    def _keys(self) -> str:
        rows = []
        for key in self.data["keys"]:
            place = -1
            if key["start"]:
                group, k = key["start"]
                place = self.data["q" if group == "q" else "v"]["places"][k]
            numbers = ", ".join(literal(float(key[name])) for name in ("value", "low", "high"))
            rows.append(f'{{"{comment(key["name"])}", {numbers}, {place}}}')
        rows = rows or ['{"", 0.0, 0.0, 0.0, -1}']
        listed = ",\n    ".join(rows)
        text = (
            "/* state : the place in the state of a start, -1 of a number of the equations */\n"
            "static const struct {\n    const char *name;\n    double value, low, high;\n    int state;\n"
            f"}} KEY[] = {{\n    {listed}\n}};\n"
        )
        pairs = ", ".join(f"{{{k}, {literal(float(x))}}}" for k, x in self._specials) or "{0, 0.0}"
        return text + wrapped(
            f"static const struct {{ int key; double value; }} SPECIAL[] = {{{pairs}}};", ""
        )

    def _events(self) -> str:
        passing = self.data["passing"]
        rows = [
            f'{{"{comment(event["name"])}", {passing >> k & 1}, {int(event["kind"] == "DEAD_POINT")}}}'
            for k, event in enumerate(self.data["events"])
        ]
        listed = ",\n    ".join(rows) or '{"", 0, 0}'
        return (
            "static const struct {\n    const char *name;\n    int passed, dead;\n"
            f"}} EVENT[] = {{\n    {listed}\n}};"
        )

    def _reasons(self) -> str:
        words = ",\n    ".join(f'"{comment(x)}"' for x in ("", *self.data["reasons"].values()))
        return f"static const char *const REASON[] = {{\n    {words}\n}};"

    @property
    def specs(self) -> str:
        """The runs that are made."""
        count = self.constants["N_COUNT"]
        head = (
            "typedef struct {\n    void (*rule)(const Given *, Judged *, double *);\n    int draw;\n    int64_t most;\n"
            f"    int64_t n[{count}];\n}} Spec;\n"
        )
        d = self.data
        parts = {"FIRST": [d["first"]], "SECOND[]": self.seconds}
        if self.thirds:
            parts["THIRD[]"] = self.thirds
        if d["locks"]:
            parts["PICTURE"] = [d["picture"]]
        texts = [head]
        for name, specs in parts.items():
            rows = [
                f"{{{rule_name(s['rule'])}, {s['draw']}, {-1 if s['most'] is None else s['most']}, "
                f"{{{', '.join(map(str, s['n']))}}}}}"
                for s in specs
            ]
            listed = "{" + ", ".join(rows) + "}" if name.endswith("[]") else rows[0]
            texts.append(wrapped(f"static const Spec {name} = {listed};", ""))
        first = self.structure.judging.first
        texts.append(f"#define NOMINAL_STEPS {literal(float(first.steps[0]))}")
        texts.append(f"#define NOMINAL_TIME {literal(float(first.time[0]))}")
        return "\n".join(texts) + "\n"


def _doubles(name: str, values: Sequence[Any]) -> str:
    numbers = [float(str(x).replace("Infinity", "inf")) for x in values]
    listed = ", ".join(map(double, numbers)) or "0.0"
    return wrapped(f"static const double {name}[{max(1, len(numbers))}] = {{{listed}}};", "")


def _integers(name: str, values: Sequence[Any], kind: str) -> str:
    array = np.atleast_1d(np.array(values, dtype=int))
    if array.ndim == 2:
        inside = ", ".join("{" + (", ".join(map(str, row)) or "0") + "}" for row in array.tolist())
    else:
        inside = ", ".join(map(str, array.tolist())) or "0"
    return wrapped(f"static const {kind} {name}[{max(1, array.shape[-1])}] = {{{inside}}};", "")
