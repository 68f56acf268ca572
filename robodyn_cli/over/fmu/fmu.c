/* FMI 3.0 co-simulation of own. The loop takes its own steps and none is cut for a communication point, unless there
   are inputs: a point is a sample of dense output. A second, more accurate integration goes along; errors are the
   largest differences so far. */

#include "fmi3.h"
#include "fmu_data.h"
#include "own_loop.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { NX = own_STATES, OUT_X = 0, OUT_MORE = NX, OUT_ERROR = NX + MORE, OUT_TIME_ERROR = 2 * NX + MORE,
       OUTS = 2 * NX + MORE + 1 };
enum { FIRST_KEY = 1, FIRST_OUT = FIRST_KEY + KEYS, HOLD = FIRST_OUT + OUTS, HAS_ENDED, EVENT_NUMBER, EVENTS_PASSED };

typedef enum { INSTANTIATED, INITIALISING, STEPPING, TERMINATED, BROKEN } Stage;

typedef struct {
    own_loop first, again;
    double values[KEYS + 1], out[OUTS], largest[NX], time;
    int fresh, cut, changed;
    Stage stage;
    bool hold, ended, early;
} State;

typedef struct {
    State state;
    fmi3LogMessageCallback log;
    fmi3InstanceEnvironment environment;
    char message[320];
} Unit;

static fmi3Status refuse(Unit *unit, const char *message)
{
    if (unit->log)
        unit->log(unit->environment, fmi3Error, "logStatusError", message);
    return fmi3Error;
}

static fmi3Status refuse_key(Unit *unit, fmi3ValueReference key, const char *message)
{
    snprintf(unit->message, sizeof unit->message, "%.200s: %s", KEY_NAME[key], message);
    return refuse(unit, unit->message);
}

static void set_nominal(State *s)
{
    own_loop_values(s->values);
    s->hold = false;
    s->stage = INSTANTIATED;
}

/* Notes states of both integrations: errors are twice the largest differences so far, and what rounding leaves. */
static void note(State *s, const double *x, const double *y)
{
    const double rounded = 4.5e-16 * sqrt(1.0 + own_loop_steps(&s->first));
    int k;

    memcpy(s->out + OUT_X, x, NX * sizeof(double));
    for (k = 0; k < NX; ++k) {
        const double apart = 2.0 * fabs(x[k] - y[k]);
        if (!(apart <= s->out[OUT_ERROR + k]))
            s->out[OUT_ERROR + k] = apart;
        if (fabs(x[k]) > s->largest[k])
            s->largest[k] = fabs(x[k]);
        if (!(rounded * s->largest[k] <= s->out[OUT_ERROR + k]))
            s->out[OUT_ERROR + k] = rounded * s->largest[k];
    }
    s->fresh = 0;
}

/* Starts both integrations from the values. */
static int begin(State *s)
{
    double x[NX], y[NX];
    int reason = own_loop_begin(&s->first, s->values, 0);

    if (!reason)
        reason = own_loop_begin(&s->again, s->values, 1);
    if (reason)
        return reason;
    memset(s->out, 0, sizeof s->out);
    memset(s->largest, 0, sizeof s->largest);
    s->time = 0.0;
    s->ended = false;
    s->changed = 0;
    s->cut = INPUTS > 0;
    own_loop_state(&s->first, x);
    own_loop_state(&s->again, y);
    note(s, x, y);
    return 0;
}

static int advance(State *s, own_loop *loop, double time, double step, double *x)
{
    return s->cut ? own_loop_stop(loop, time, step, x) : own_loop_to(loop, time, x);
}

/* Goes to a time; the motion may end before. Returns 0, or what has failed. */
static const char *go_to(State *s, double time)
{
    double x[NX], y[NX];
    const double step = time - s->time;
    int reached, other;

    if (s->changed && (own_loop_change(&s->first, s->values, 0) || own_loop_change(&s->again, s->values, 1)))
        return "these inputs have other equations";
    s->changed = 0;
    reached = advance(s, &s->first, time, step, x);
    if (reached == own_FAILED)
        return time > KNOWN ? "what the motion follows is known up to its duration" : "the integration has failed";
    other = advance(s, &s->again, time, 0.5 * step, y);
    s->time = own_loop_time(&s->first);
    if (reached == own_ENDED) {
        if (other == own_REACHED) /* its end comes a little later */
            other = advance(s, &s->again, time + 1e-3 * s->time, 0.5 * step, y);
        if (other != own_ENDED)
            return "no second integration confirms the end";
        s->out[OUT_TIME_ERROR] = 2.0 * fabs(own_loop_time(&s->again) - s->time) + 1e-14 * s->time;
        s->ended = true;
    }
    if (other == own_FAILED)
        return "the second integration has failed";
    note(s, x, y);
    return NULL;
}

static void refresh(State *s)
{
#if MORE
    if (!s->fresh)
        own_loop_outputs(&s->first, s->time, s->out + OUT_X, s->out + OUT_MORE);
#endif
    s->fresh = 1;
}

FMI3_Export const char *fmi3GetVersion(void)
{
    return "3.0";
}

FMI3_Export fmi3Status fmi3SetDebugLogging(fmi3Instance i, fmi3Boolean on, size_t count, const fmi3String categories[])
{
    (void)i;
    (void)on;
    (void)count;
    (void)categories;
    return fmi3OK;
}

FMI3_Export fmi3Instance fmi3InstantiateCoSimulation(
    fmi3String name, fmi3String token, fmi3String path, fmi3Boolean visible, fmi3Boolean logging, fmi3Boolean events,
    fmi3Boolean early, const fmi3ValueReference needed[], size_t count, fmi3InstanceEnvironment environment,
    fmi3LogMessageCallback log, fmi3IntermediateUpdateCallback update)
{
    Unit *unit = strcmp(token, TOKEN) == 0 ? calloc(1, sizeof *unit) : NULL;

    (void)name;
    (void)path;
    (void)visible;
    (void)events;
    (void)needed;
    (void)count;
    (void)update;
    if (!unit) {
        if (log)
            log(environment, fmi3Error, "logStatusError", "the token is that of another unit, or memory is short");
        return NULL;
    }
    unit->log = logging ? log : NULL;
    unit->environment = environment;
    unit->state.early = early;
    set_nominal(&unit->state);
    return unit;
}

FMI3_Export void fmi3FreeInstance(fmi3Instance i)
{
    free(i);
}

FMI3_Export fmi3Status fmi3EnterInitializationMode(
    fmi3Instance i, fmi3Boolean has, fmi3Float64 tolerance, fmi3Float64 start, fmi3Boolean ends, fmi3Float64 stop)
{
    Unit *unit = i;

    (void)has;
    (void)tolerance;
    (void)ends;
    (void)stop;
    if (unit->state.stage != INSTANTIATED)
        return refuse(unit, "initialisation follows instantiation");
    if (start != 0.0)
        return refuse(unit, "the motion starts at t = 0");
    unit->state.stage = INITIALISING;
    return fmi3OK;
}

FMI3_Export fmi3Status fmi3ExitInitializationMode(fmi3Instance i)
{
    Unit *unit = i;
    int reason;

    if (unit->state.stage != INITIALISING)
        return refuse(unit, "there is no initialisation to leave");
    reason = begin(&unit->state);
    if (reason) {
        unit->state.stage = BROKEN;
        return refuse(unit, own_loop_reason(reason));
    }
    unit->state.stage = STEPPING;
    return fmi3OK;
}

FMI3_Export fmi3Status fmi3Terminate(fmi3Instance i)
{
    Unit *unit = i;

    unit->state.stage = TERMINATED;
    return fmi3OK;
}

FMI3_Export fmi3Status fmi3Reset(fmi3Instance i)
{
    Unit *unit = i;

    set_nominal(&unit->state);
    return fmi3OK;
}

FMI3_Export fmi3Status fmi3GetFloat64(
    fmi3Instance i, const fmi3ValueReference r[], size_t n, fmi3Float64 x[], size_t count)
{
    Unit *unit = i;
    State *s = &unit->state;
    size_t k;

    (void)count;
    if (s->stage == BROKEN)
        return refuse(unit, "the motion has failed: it has no values");
    if (s->stage == INITIALISING) {
        const int reason = begin(s);
        if (reason)
            return refuse(unit, own_loop_reason(reason));
    }
    refresh(s);
    for (k = 0; k < n; ++k) {
        if (r[k] >= FIRST_OUT + OUTS)
            return refuse(unit, "there is no such Float64");
        x[k] = r[k] == 0 ? s->time : r[k] < FIRST_OUT ? s->values[r[k] - FIRST_KEY] : s->out[r[k] - FIRST_OUT];
    }
    return fmi3OK;
}

FMI3_Export fmi3Status fmi3SetFloat64(
    fmi3Instance i, const fmi3ValueReference r[], size_t n, const fmi3Float64 x[], size_t count)
{
    Unit *unit = i;
    State *s = &unit->state;
    size_t k;

    (void)count;
    for (k = 0; k < n; ++k) {
        const fmi3ValueReference key = r[k] - FIRST_KEY;
        if (r[k] < FIRST_KEY || r[k] >= FIRST_OUT)
            return refuse(unit, "it is no parameter and no input");
        if (!(x[k] >= KEY_LOW[key] && x[k] <= KEY_HIGH[key]))
            return refuse_key(unit, key, "a value is outside its range");
        if (s->stage == STEPPING && !KEY_INPUT[key])
            return refuse_key(unit, key, "parameters stay as they are behind the initialisation");
        s->changed |= s->stage == STEPPING && s->values[key] != x[k];
        s->values[key] = x[k];
    }
    return fmi3OK;
}

FMI3_Export fmi3Status fmi3GetBoolean(
    fmi3Instance i, const fmi3ValueReference r[], size_t n, fmi3Boolean x[], size_t count)
{
    Unit *unit = i;
    size_t k;

    (void)count;
    for (k = 0; k < n; ++k) {
        if (r[k] != HOLD && r[k] != HAS_ENDED)
            return refuse(unit, "there is no such Boolean");
        x[k] = r[k] == HOLD ? unit->state.hold : unit->state.ended;
    }
    return fmi3OK;
}

FMI3_Export fmi3Status fmi3SetBoolean(
    fmi3Instance i, const fmi3ValueReference r[], size_t n, const fmi3Boolean x[], size_t count)
{
    Unit *unit = i;
    size_t k;

    (void)count;
    for (k = 0; k < n; ++k) {
        if (r[k] != HOLD || unit->state.stage == STEPPING)
            return refuse(unit, "it is no Boolean that can be set now");
        unit->state.hold = x[k];
    }
    return fmi3OK;
}

FMI3_Export fmi3Status fmi3GetInt32(
    fmi3Instance i, const fmi3ValueReference r[], size_t n, fmi3Int32 x[], size_t count)
{
    Unit *unit = i;
    const State *s = &unit->state;
    size_t k;

    (void)count;
    for (k = 0; k < n; ++k) {
        if (r[k] != EVENT_NUMBER && r[k] != EVENTS_PASSED)
            return refuse(unit, "there is no such Int32");
        if (s->stage == INSTANTIATED)
            x[k] = r[k] == EVENT_NUMBER ? -1 : 0;
        else
            x[k] = r[k] == EVENT_NUMBER ? own_loop_last_event(&s->first) : own_loop_passed(&s->first);
    }
    return fmi3OK;
}

FMI3_Export fmi3Status fmi3DoStep(
    fmi3Instance i, fmi3Float64 time, fmi3Float64 step, fmi3Boolean no_set, fmi3Boolean *event, fmi3Boolean *terminate,
    fmi3Boolean *early, fmi3Float64 *reached)
{
    Unit *unit = i;
    State *s = &unit->state;
    const char *failed = NULL;

    (void)no_set;
    *event = *terminate = *early = false;
    *reached = s->time;
    if (s->stage != STEPPING)
        return refuse(unit, "steps follow the initialisation");
    if (!(step > 0.0) || (!s->ended && !(fabs(time - s->time) <= 1e-9 * (1.0 + fabs(time)))))
        return refuse(unit, "a step goes on from where the last one ended");
#if TIME_OF_POINTS >= 0
    /* rates of set points count from each communication point on */
    s->changed |= s->values[TIME_OF_POINTS] != s->time;
    s->values[TIME_OF_POINTS] = s->time;
#endif
    if (!s->ended)
        failed = go_to(s, time + step);
    if (failed) {
        s->stage = BROKEN;
        return refuse(unit, failed);
    }
    if (s->ended && s->hold) {
        *reached = s->time = time + step; /* what is put out stays */
        s->fresh = 0;
        return fmi3OK;
    }
    *reached = s->time;
    *terminate = s->ended;
    *early = s->ended && s->early;
    return fmi3OK;
}

/* ---- states: memory has no addresses that are kept between calls ---- */

FMI3_Export fmi3Status fmi3GetFMUState(fmi3Instance i, fmi3FMUState *state)
{
    Unit *unit = i;

    if (!*state)
        *state = malloc(sizeof(State));
    if (!*state)
        return refuse(unit, "memory is short");
    memcpy(*state, &unit->state, sizeof(State));
    return fmi3OK;
}

FMI3_Export fmi3Status fmi3SetFMUState(fmi3Instance i, fmi3FMUState state)
{
    Unit *unit = i;

    if (!state)
        return refuse(unit, "there is no state");
    memcpy(&unit->state, state, sizeof(State));
    return fmi3OK;
}

FMI3_Export fmi3Status fmi3FreeFMUState(fmi3Instance i, fmi3FMUState *state)
{
    (void)i;
    free(*state);
    *state = NULL;
    return fmi3OK;
}

FMI3_Export fmi3Status fmi3SerializedFMUStateSize(fmi3Instance i, fmi3FMUState state, size_t *size)
{
    (void)i;
    (void)state;
    *size = sizeof(State);
    return fmi3OK;
}

FMI3_Export fmi3Status fmi3SerializeFMUState(fmi3Instance i, fmi3FMUState state, fmi3Byte bytes[], size_t size)
{
    Unit *unit = i;

    if (!state || size < sizeof(State))
        return refuse(unit, "there is no room for the state");
    memcpy(bytes, state, sizeof(State));
    return fmi3OK;
}

FMI3_Export fmi3Status fmi3DeserializeFMUState(
    fmi3Instance i, const fmi3Byte bytes[], size_t size, fmi3FMUState *state)
{
    Unit *unit = i;

    if (size != sizeof(State))
        return refuse(unit, "it is the state of another unit");
    if (!*state)
        *state = malloc(sizeof(State));
    if (!*state)
        return refuse(unit, "memory is short");
    memcpy(*state, bytes, sizeof(State));
    return fmi3OK;
}
