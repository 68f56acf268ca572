"""The library of a simulation: ``NAME_loop.h`` and ``NAME_loop.c``."""

from __future__ import annotations

import re
from functools import cached_property

from robodyn_cli.kernels.as_c.words import text_beside, used_functions
from robodyn_cli.kernels.c99 import comment, identifier
from robodyn_cli.over.loop_c.structure import CStructure
from robodyn_cli.over.loop_c.tables import FOREVER, LoopTables
from robodyn_cli.version import __version__

HEADER = """/*
 * {own}_loop: the simulation of the scene {scene}, written by robodyn {version}.
 *
 * Units are SI. Nothing is allocated, nothing is kept but in memory of the caller, whose bytes may be copied; several
 * simulations may be in use at once, in any threads. Where {big}_VECTORS is defined, the code uses vectors of GCC and
 * Clang.
 *
 * States x ({states}): {columns}.
 * Values of the keys have the order of enum {own}_loop_keys.
 */

#ifndef {big}_LOOP_H
#define {big}_LOOP_H

enum {own}_loop_keys {{
{keys}    {big}_LOOP_KEYS
}};
enum {{ {big}_LOOP_NQ = {nq}, {big}_LOOP_NV = {nv}, {big}_LOOP_NX = {states}, {big}_LOOP_EVENTS = {events} }};
enum {{ {big}_LOOP_SAMPLES = {samples} }}; /* rows that {own}_loop_run writes, at most */
enum {{ {big}_LOOP_REACHED, {big}_LOOP_ENDED, {big}_LOOP_FAILED }};
#define {big}_LOOP_DURATION {duration} /* s */

/* One integration. */
typedef struct {{
    double memory[{loop}];
}} {own}_loop;

/* What {own}_loop_run works in. */
typedef struct {{
    double memory[{room}];
}} {own}_loop_room;

/* The end of a motion, with its errors. event : that ends it, -1 for none. samples : rows that were written. */
typedef struct {{
    double time, time_error;
    double q[{nq_room}], q_error[{nq_room}], qd[{nv_room}], qd_error[{nv_room}];
    int steps, second_steps, event, samples;
}} {own}_loop_result;

#ifdef __cplusplus
extern "C" {{
#endif

/* The values of all keys in the scene. */
void {own}_loop_values(double values[{key_room}]);

/* The place of a key by its name, -1 for none. */
int {own}_loop_key(const char *name);

/* Makes the whole motion with these values, and once more with greater accuracy, for its errors.

   Returns 0; else a reason why robodyn itself has to be asked, see {own}_loop_reason, and NaN for times and states.
   samples : rows of states from the start to the end, evenly spaced up to the end or, of a motion that locks, up to the
   lock; NULL: none are wanted. */
int {own}_loop_run({own}_loop_room *room, const double values[{key_room}], {own}_loop_result *result, double *samples);

/* Sets a motion on its start, for going step by step. again : 1 for the more accurate integration, from whose
   difference errors are told. Returns 0, or a reason. */
int {own}_loop_begin({own}_loop *loop, const double values[{key_room}], int again);

/* Goes to a time, and gives the state there. The integration keeps its own steps: to how many times it goes changes
   nothing but rounding.

   Returns {big}_LOOP_REACHED; {big}_LOOP_ENDED where the motion has ended before, with the state at its end, now and
   ever after; {big}_LOOP_FAILED where the integration has failed, with a state of NaN, now and ever after, or, with the
   motion left where it stands, for a time before the present one ({own}_loop_time){known}. */
int {own}_loop_to({own}_loop *loop, double time, double x[{states}]);

/* The same with a step that ends there, and none that is longer than so much. Behind it values may change. */
int {own}_loop_stop({own}_loop *loop, double time, double longest, double x[{states}]);

/* Goes on with other values of keys that are no starts, from the time of the last stop. Returns 0, or a reason. */
int {own}_loop_change({own}_loop *loop, const double values[{key_room}], int again);

/* The state where it stands. */
void {own}_loop_state(const {own}_loop *loop, double x[{states}]);
{outputs}
/* The time that was reached; steps that were made; events that were passed; the last one, -1 for none. */
double {own}_loop_time(const {own}_loop *loop);
int {own}_loop_steps(const {own}_loop *loop);
int {own}_loop_passed(const {own}_loop *loop);
int {own}_loop_last_event(const {own}_loop *loop);

/* The words of a reason, the name of an event. */
const char *{own}_loop_reason(int reason);
const char *{own}_loop_event(int event);

#ifdef __cplusplus
}}
#endif

#endif
"""
SOURCE = """/* {own}_loop.h says what these functions do. */

#include "{own}_loop.h"

#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#ifdef {big}_VECTORS
#define VECTORS
#endif

/* ---- the compiled loop: statement for statement what robodyn runs itself ---- */
"""


class LoopLibrary:
    """The C of a scene's simulation. name : of the library; scene : of its file."""

    def __init__(self, structure: CStructure, name: str, scene: str) -> None:
        self.structure, self.name, self.scene = structure, name, scene
        self.tables = LoopTables(structure, name)
        self.big = name.upper()

    @property
    def key_names(self) -> list[str]:
        """What the members of the enumeration of keys are called."""
        names: list[str] = []
        for key in self.tables.data["keys"]:
            own, k = f"{self.big}_LOOP_KEY_{identifier(key['name'])}", 2
            while own in names:
                own, k = f"{self.big}_LOOP_KEY_{identifier(key['name'])}_{k}", k + 1
            names.append(own)
        return names

    @property
    def columns(self) -> list[tuple[str, str]]:
        """Names and units of the states."""
        d = self.tables.data
        found = [("", "")] * d["size"]
        for group, rate, prefix in (("q", "", "q"), ("v", "/s", "qd")):
            own = d[group]
            for name, unit, place in zip(own["names"], own["units"], own["places"]):
                found[place] = f"{prefix}.{name}", unit + rate
        control = self.structure.motion.problem.control
        own = [] if control is None else [f"z.{name}" for name in control.names]
        extra = iter([*own, *(f"z.{k}" for k in range(len(own), d["size"]))])
        return [x if x[0] else (next(extra), "1") for x in found]

    @property
    def _outputs(self) -> str:
        """The declaration of further outputs, where there are any."""
        sizes = self.tables.constants
        count = sizes["OBSERVED"] + sizes["REACTIONS"]
        if not count:
            return ""
        arguments = f"{self.name}_loop *loop, double time, const double x[{sizes['NX']}], double out[{count}]"
        return f"\n/* What else is put out at a time and state. */\nvoid {self.name}_loop_outputs({arguments});\n"

    @cached_property
    def header(self) -> str:
        """The text of the header."""
        t, d = self.tables, self.tables.data
        keys = "".join(
            f"    {name}, /* {comment(key['name'])} [{comment(key['unit'])}], {key['value']:.6g} */\n"
            for name, key in zip(self.key_names, d["keys"])
        )
        nq, nv = len(d["q"]["names"]), len(d["v"]["names"])
        integration = sum(t.integration.values())
        return HEADER.format(
            own=self.name, big=self.big, scene=comment(self.scene), version=__version__, keys=keys, nq=nq, nv=nv,
            nq_room=max(1, nq), nv_room=max(1, nv), states=d["size"], events=len(d["events"]), samples=t.shown + 1,
            duration=repr(float(d["duration"])), loop=integration, room=integration + sum(t.judging.values()),
            key_room=t.key_room, outputs=self._outputs,
            known="" if t.known == FOREVER else f", or beyond {t.known!r} s, up to which the motion to follow is known",
            columns=", ".join(f"{comment(name)} [{comment(unit)}]" for name, unit in self.columns),
        )  # fmt: skip

    @cached_property
    def source(self) -> str:
        """The text of the definitions."""
        t = self.tables
        runner = self._named(text_beside(__file__, "runner.c"))
        rules = t.rules.text
        operations = used_functions(text_beside(__file__, "operations.c"), [rules, runner])
        parts = [
            SOURCE.format(own=self.name, big=self.big), self.structure.code(t.equations),
            "/* ---- data of the scene ---- */\n", t.text, operations,
            "/* ---- the rules by which runs are made and judged ---- */\n", rules, t.specs, runner,
        ]  # fmt: skip
        return "\n".join(parts)

    def _named(self, text: str) -> str:
        """Return a text with names of the library."""
        text = text.replace("own_KEY_ROOM", str(self.tables.key_room)).replace(
            "own_STATES", f"{self.big}_LOOP_NX"
        )
        text = re.sub(r"\bown_(REACHED|ENDED|FAILED)\b", rf"{self.big}_LOOP_\1", text)
        return re.sub(r"\bown_", f"{self.name}_", text)
