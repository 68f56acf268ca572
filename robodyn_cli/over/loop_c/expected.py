"""Runs of Python that C is compared with, and the text of that test."""

from __future__ import annotations

import numpy as np

from robodyn_cli.kernels.c99 import literal, wrapped
from robodyn_cli.over.commands import locks
from robodyn_cli.over.live.keys import LiveKey
from robodyn_cli.over.loop_c.library import LoopLibrary
from robodyn_cli.over.many.command import ManyRuns
from robodyn_cli.over.many.mechanism import Mechanism
from robodyn_cli.spatial.algebra import Array

CHANGES = (0.0, 0.02, -0.03)  # of all values, relative; the first are those of the scene
ALLOWED = 2.0  # times the sum of both errors that are stated
ROUNDED = 1e-12  # of the largest entry: what is always allowed
CALLS = 7  # times at which a motion is compared, step by step


def expected_runs(library: LoopLibrary) -> ManyRuns:
    """Return runs of Python with values near those of the scene; those that it does not make have a code."""
    structure = library.structure
    rows = np.array([[_moved(key, x) for key in structure.keys] for x in CHANGES])
    if not structure.keys:
        rows = rows[:1].reshape(1, 0)
    mechanism = Mechanism(structure.family, [key.key.name for key in structure.keys])
    make = mechanism.deploy_many if locks(structure.command.name) else mechanism.simulate_many
    return make(rows, threads=1)


def _moved(key: LiveKey, change: float) -> float:
    x = key.value + change * (abs(key.value) or 1.0)
    return x if key.low <= x <= key.high and x not in key.key.special else key.value


TEST = """
#include "{own}_loop.h"

#include <string.h>

static {own}_loop_room loop_room;
static {own}_loop loop_there, loop_back;
static double loop_rows[{big}_LOOP_SAMPLES][{big}_LOOP_NX];

{data}

static int loop_differs(const double *is, const double *error, const double (*should)[2], int count, double most)
{{
    int k, wrong = 0;

    for (k = 0; k < count; ++k)
        wrong |= !(fabs(is[k] - should[k][0]) <= {allowed} * (error[k] + should[k][1]) + {rounded} * most);
    return wrong;
}}

/* Whole motions beside those of robodyn, within {allowed:.0f} times the sum of both errors. */
static int test_loop_runs(void)
{{
    int set, wrong = 0;

    for (set = 0; set < {sets}; ++set) {{
        {own}_loop_result result;
        int off;
        const int reason = {own}_loop_run(&loop_room, loop_values[set], &result, &loop_rows[0][0]);
        if (reason) {{
            printf("%-40s left to robodyn: %s\\n", "loop", {own}_loop_reason(reason));
            wrong = 1;
            continue;
        }}
        off = loop_differs(&result.time, &result.time_error, &loop_time[set], 1, result.time);
        off |= loop_differs(result.q, result.q_error, loop_q[set], {nq}, loop_most[set][0]);
        off |= loop_differs(result.qd, result.qd_error, loop_qd[set], {nv}, loop_most[set][1]);
        printf("%-40s end at %.12g s +- %.1e%s\\n", "loop", result.time, result.time_error, off ? "   WRONG" : "");
        wrong |= off;
    }}
    return wrong;
}}

/* Step by step: the times that are asked for change nothing but rounding, copies go on alike, the end stays. */
static int loop_rounded(const double *x, const double *y)
{{
    double most = 0.0, apart = 0.0;
    int k;

    for (k = 0; k < {big}_LOOP_NX; ++k) {{
        most = fmax(most, fabs(x[k]));
        apart = fmax(apart, fabs(x[k] - y[k]));
    }}
    return !(apart <= 1e-9 * most);
}}

static int test_loop_steps(void)
{{
    double x[{big}_LOOP_NX], y[{big}_LOOP_NX];
    const double end = {end};
    int k, wrong = {own}_loop_begin(&loop_there, loop_values[0], 0);

    for (k = 1; k <= {calls}; ++k) {{
        if (k == {calls})
            loop_back = loop_there;
        wrong |= {own}_loop_to(&loop_there, end * k / {calls}, x) != {big}_LOOP_REACHED;
    }}
    wrong |= {own}_loop_to(&loop_back, end, y) != {big}_LOOP_REACHED || memcmp(x, y, sizeof x) != 0;
    wrong |= {own}_loop_to(&loop_back, 0.1 * end, y) != {big}_LOOP_FAILED || memcmp(x, y, sizeof x) != 0;
    wrong |= {own}_loop_begin(&loop_back, loop_values[0], 0);
    wrong |= {own}_loop_to(&loop_back, end, y) != {big}_LOOP_REACHED || loop_rounded(x, y);
{locked}    printf("%-40s %s\\n", "loop step by step", wrong ? "WRONG" : "as it should be");
    return wrong;
}}
{refused}
static int test_loop(void)
{{
    return test_loop_runs() | test_loop_steps(){also};
}}
"""
LOCKED = """    wrong |= {own}_loop_to(&loop_there, 2.0 * {time}, x) != {big}_LOOP_ENDED;
    wrong |= !(fabs({own}_loop_time(&loop_there) - {time}) <= 1e-6 * {time});
    wrong |= {own}_loop_to(&loop_there, 3.0 * {time}, y) != {big}_LOOP_ENDED || memcmp(x, y, sizeof x) != 0;
"""
REFUSED = """
static int test_loop_keys(void)
{{
    double values[{room}];
    {own}_loop_result result;
    int wrong = {own}_loop_key("{key}") != 0 || {own}_loop_key("no such key") != -1;

    {own}_loop_values(values);
    values[0] = (double)NAN;
    wrong |= {own}_loop_run(&loop_room, values, &result, 0) == 0;
    printf("%-40s %s\\n", "keys of the loop", wrong ? "WRONG" : "as they should be");
    return wrong;
}}
"""


def loop_test(library: LoopLibrary) -> str:
    """Return the definition of ``test_loop`` for the self test."""
    runs, own, tables = expected_runs(library), library.name, library.tables
    made = [k for k in range(len(runs)) if not runs.code[k]] or [0]
    room = tables.key_room
    values = np.zeros((len(made), room))
    values[:, : runs.values.shape[1]] = runs.values[made]
    pairs = {
        "loop_time": np.stack([runs.time, np.nan_to_num(runs.time_error)], axis=-1)[made],
        "loop_q": np.stack([runs.q, np.nan_to_num(runs.q_error)], axis=-1)[made],
        "loop_qd": np.stack([runs.qd, np.nan_to_num(runs.qd_error)], axis=-1)[made],
    }
    most = np.stack([np.abs(x[made]).max(axis=1, initial=0.0) for x in (runs.q, runs.qd)], axis=-1)
    data = [_table("loop_values", values), _table("loop_most", most)]
    data += [_table(name, x) for name, x in pairs.items()]
    time = float(runs.time[made[0]])
    names = {"own": own, "big": library.big}
    keys = tables.data["keys"]
    return TEST.format(
        **names, data="\n".join(data), allowed=ALLOWED, rounded=ROUNDED, sets=len(made), nq=runs.q.shape[1],
        nv=runs.qd.shape[1], calls=CALLS, end=literal(0.9 * time),
        locked=LOCKED.format(**names, time=literal(time)) if tables.data["locks"] else "",
        refused=REFUSED.format(**names, room=room, key=keys[0]["name"]) if keys else "",
        also=" | test_loop_keys()" if keys else "",
    )  # fmt: skip


def _table(name: str, rows: Array) -> str:
    def listed(x: Array) -> str:
        return "{" + ", ".join(literal(float(v)) if np.ndim(v) == 0 else listed(v) for v in x) + "}"

    shape = "".join(f"[{n}]" for n in rows.shape)
    return wrapped(f"static const double {name}{shape} = {listed(rows)};", "")
