/* ---- numbers and start -------------------------------------------------------------------------------------------- */

static void connect(Integration *m, double *out)
{
    char *where[PLACES] = {0};
    int k;

    where[PLACE_w] = (char *)m->block + AT_W;
    where[PLACE_n] = (char *)m->block + AT_N;
    where[PLACE_y] = (char *)m->block + AT_Y;
    where[PLACE_dense] = (char *)m->block + AT_DENSE;
    where[PLACE_p] = (char *)m->p;
    where[PLACE_out] = (char *)out;
    where[PLACE_tables] = (char *)m->tables;
    where[PLACE_scratch] = (char *)m->scratch;
    where[PLACE_work] = (char *)m->work;
    where[PLACE_numbers] = (char *)m->numbers;
    where[PLACE_registers] = (char *)m->registers;
    where[PLACE_updates] = (char *)m->updates;
    where[PLACE_saved] = (char *)m->saved;
    where[PLACE_values] = (char *)m->values;
    where[PLACE_bracket] = (char *)m->bracket;
    memcpy(m->updates, UPDATE, sizeof UPDATE);
    for (k = 0; k < PLACES; ++k)
        if (k == PLACE_bytes)
            store_l((char *)(m->places + k), BLOCK);
        else
            store_p((char *)(m->places + k), where[k]);
}

static int64_t counted(const double *block, int k)
{
    return load_l((const char *)block + AT_N + 8 * k);
}

static void set_count(double *block, int k, int64_t n)
{
    store_l((char *)block + AT_N + 8 * k, n);
}

/* Sets the table of numbers. Returns 0, or why these values are left to robodyn. */
static int set_numbers(Integration *m, const double *values)
{
    double given[KEYS + 1] = {0};
    int k, count = 0;

    for (k = 0; k < KEYS; ++k) {
        if (!(values[k] >= KEY[k].low && values[k] <= KEY[k].high))
            return REASON_range;
        if (KEY[k].state < 0)
            given[count++] = values[k];
    }
    for (k = 0; k < SPECIALS; ++k)
        if (values[SPECIAL[k].key] == SPECIAL[k].value)
            return REASON_special;
    memcpy(m->table, NUMBERS, sizeof NUMBERS);
    return loop_numbers((char *)given, (char *)m->table) == 1 ? 0 : REASON_structure;
}

/* Sets the numbers that the loop reads: put off by so many halves of a unit in the last place in second runs. */
static void put_off(const double *table, double *numbers, int draw)
{
    int k;

    for (k = 0; k < OWN; ++k)
        numbers[k] = draw ? table[k] * (1.0 + OFF[draw - 1][k] * 1.1102230246251565e-16) : table[k];
}

static int all_finite(const double *x)
{
    int k;

    for (k = 0; k < NX; ++k)
        if (x[k] - x[k] != 0.0)
            return 0;
    return 1;
}

#if CLOSING
/* Evaluates the loops at positions in x. Returns the largest residual in parts of its size. */
static double residual(Integration *m, const double *x)
{
    const double *length = m->results + ETA + PSI + COSINES;
    double size = 0.0;
    int k;

    loop_loops((char *)(uintptr_t)x, (char *)m->table, (char *)m->results);
    for (k = 0; k < ETA; ++k)
        size = most(size, fabs(LONG[k] ? m->results[k] / *length : m->results[k]));
    return size;
}

/* Gives the loops as they were evaluated last. */
static void give_loops(const Integration *m, Given *given)
{
    given->eta = m->results;
    given->psi = m->results + ETA;
    given->cosines = m->results + ETA + PSI;
    given->size = m->results + ETA + PSI + COSINES;
}

/* Damped Gauss-Newton steps of some coordinates onto the loops. */
static void newton(Integration *m, double *x, void (*step)(const Given *, Judged *, double *))
{
    double size = residual(m, x), moves[NV];
    int slow = 0, round, k, j;

    for (round = 0; round < ITERATIONS && size > TINY && slow <= PATIENT; ++round) {
        Given given = {0};
        Judged judged = {0};
        double trial[NX], part = 1.0, next = size;
        int found = 0;
        give_loops(m, &given);
        step(&given, &judged, m->closing);
        memcpy(moves, judged.step, sizeof moves);
        for (k = 0; k < HALVINGS && !found; ++k, part *= 0.5) {
            memcpy(trial, x, sizeof trial);
            for (j = 0; j < NV; ++j)
                trial[Q_PLACE[j]] += part * moves[j];
            next = residual(m, trial);
            found = next < size;
            if (size <= CLOSED)
                break;
        }
        if (!found)
            break;
        slow = next > 0.5 * size ? slow + 1 : 0;
        size = next;
        memcpy(x, trial, sizeof trial);
    }
    residual(m, x);
}

/* The pose that is chosen so far: its distance from the start, whether it is regular (-1: there is none), and sure. */
typedef struct {
    double q[NV], distance, full, sure;
} Chosen;

static void give_chosen(const Chosen *best, Given *given)
{
    given->best_q = best->q;
    given->best_distance = &best->distance;
    given->best_full = &best->full;
    given->best_sure = &best->sure;
}

static void positions(const double *x, double *q)
{
    int k;

    for (k = 0; k < NV; ++k)
        q[k] = x[Q_PLACE[k]];
}

static void set_positions(double *x, const double *q)
{
    int k;

    for (k = 0; k < NV; ++k)
        x[Q_PLACE[k]] = q[k];
}

/* Closes the loops from one of the starts, and chooses between that pose and the best. */
static void close_from(Integration *m, const double *start, const double *part, double *x, Chosen *best)
{
    Given given = {0};
    Judged judged = {0};
    double q[NV];

    give_loops(m, &given);
    given.q = start;
    given.part = part;
    rule_begin(&given, &judged, m->closing);
    set_positions(x, judged.q);
#if MISSING
    newton(m, x, rule_step_missing);
#endif
#if FREE
    newton(m, x, rule_step_free);
#endif
#if MISSING
    positions(x, q);
    given.q = q;
    rule_wrapped(&given, &judged, m->closing);
    set_positions(x, judged.q);
    if (!(residual(m, x) <= CLOSED))
        set_positions(x, q);
#endif
    if (!(residual(m, x) <= CLOSED))
        return;
    positions(x, q);
    give_loops(m, &given);
    give_chosen(best, &given);
    given.q = q;
    given.start = start;
    rule_preferred(&given, &judged, m->closing);
    memcpy(best->q, judged.best_q, sizeof best->q);
    best->distance = judged.best_distance[0];
    best->full = judged.best_full[0];
    best->sure = judged.best_sure[0];
}

/* Closes the loops from the state x that is given, as robodyn does: from many starts, of which the nearest counts.
   Returns 0, or why these values are left to robodyn. */
static int close_loops(Integration *m, double *x)
{
    Given given = {0};
    Judged judged = {0};
    Chosen best = {{0.0}, HUGE_VAL, -1.0, 1.0};
    double start[NV], v[NV];
    int stage, k, n = 0;

    positions(x, start);
    memcpy(best.q, start, sizeof start);
    residual(m, x);
    for (stage = 0; stage < STAGES && best.full < 0.0; ++stage)
        for (; n < STAGE_END[stage]; ++n)
            close_from(m, start, PART + n * NV, x, &best);
    set_positions(x, best.q);
    residual(m, x);
    for (k = 0; k < NV; ++k)
        v[k] = x[V_PLACE[k]];
    give_loops(m, &given);
    give_chosen(&best, &given);
    given.v = v;
    rule_closed(&given, &judged, m->closing);
    if (judged.good[0] == 0.0)
        return REASON_closed;
    for (k = 0; k < NV; ++k)
        x[V_PLACE[k]] = judged.v[k];
    return 0;
}
#endif

/* Returns 0, or why the bodies at a state x are left to robodyn. */
static int no_bodies(Integration *m, const double *x)
{
#if DEFINITE
    Given given = {0};
    Judged judged = {0};

    loop_inertia((char *)(uintptr_t)x, (char *)m->table, (char *)m->results);
    given.mass = m->results;
    given.psi = m->results + MASS;
    rule_definite(&given, &judged, m->closing);
    return judged.good[0] != 0.0 ? 0 : REASON_definite;
#else
    (void)m;
    (void)x;
    return 0;
#endif
}

#if BEGUN
/* Makes the first update of a sampled controller, at t = 0. */
static void first_sample(Integration *m)
{
    loop_begun((char *)m->x, (char *)m->table, (char *)m->results);
    memcpy(m->x + FIRST_BEGUN, m->results, BEGUN * sizeof(double));
}
#endif

/* Sets the state that values start from. Returns 0, or why these values are left to robodyn. */
static int set_start(Integration *m, const double *values)
{
    int k, changed = 0, reason = 0;

    for (k = 0; k < KEYS; ++k)
        changed |= values[k] != KEY[k].value;
    memcpy(m->x, changed ? GIVEN : START, sizeof START);
    for (k = 0; k < KEYS; ++k)
        if (changed && KEY[k].state >= 0)
            m->x[KEY[k].state] = values[k];
#if CLOSING
    reason = changed ? close_loops(m, m->x) : 0;
#endif
#if BEGUN
    first_sample(m);
#endif
    return reason ? reason : no_bodies(m, m->x);
}

/* Closed loops have other positions that close them as well, by rounding: second runs start from these. */
static void start_beside(Integration *m, double *x)
{
#if BESIDE
    Given given = {0};
    Judged judged = {0};
    int k;

    loop_psi((char *)m->x, (char *)m->table, (char *)m->results);
    given.psi = m->results;
    rule_beside(&given, &judged, m->closing);
    memcpy(x, m->x, sizeof m->x);
    for (k = 0; k < NV; ++k)
        x[Q_PLACE[k]] += judged.step[k];
#else
    memcpy(x, m->x, sizeof m->x);
#endif
}

void own_loop_values(double values[own_KEY_ROOM])
{
    int k;

    values[0] = 0.0;
    for (k = 0; k < KEYS; ++k)
        values[k] = KEY[k].value;
}

int own_loop_key(const char *name)
{
    int k;

    for (k = 0; k < KEYS; ++k)
        if (strcmp(name, KEY[k].name) == 0)
            return k;
    return -1;
}

const char *own_loop_reason(int reason)
{
    return reason >= 0 && reason < REASONS ? REASON[reason] : "";
}

const char *own_loop_event(int event)
{
    return event >= 0 && event < EVENTS ? EVENT[event].name : "";
}

/* ---- step by step ------------------------------------------------------------------------------------------------- */

/* Sets the doubles of a run by a rule. Returns whether it is one that is made. */
static int row_of(const Spec *spec, const Given *given, double *scratch, double *w, int64_t *steps)
{
    Judged judged = {0};

    spec->rule(given, &judged, scratch);
    if (judged.when && judged.when[0] == 0.0)
        return 0;
    memcpy(w, judged.w, W_COUNT * sizeof(double));
    *steps = spec->most >= 0 ? spec->most : (int64_t)floor(judged.most[0] + 0.5);
    return 1;
}

static void begin_block(Integration *m, const double *w, const int64_t *n, int64_t steps, const double *x)
{
    int k;

    memset(m->block, 0, sizeof m->block);
    memcpy((char *)m->block + AT_W, w, W_COUNT * sizeof(double));
    for (k = 0; k < N_COUNT; ++k)
        set_count(m->block, k, n[k]);
    set_count(m->block, COUNT_MAX_STEPS, steps);
    memcpy((char *)m->block + AT_Y, x, NX * sizeof(double));
    memcpy(m->p, PARAMETER, sizeof m->p);
}

int own_loop_begin(own_loop *loop, const double values[own_KEY_ROOM], int again)
{
    Integration *m = (Integration *)(void *)loop->memory;
    double w[W_COUNT], x[NX], taken = NOMINAL_STEPS, went = NOMINAL_TIME, nothing = 0.0;
    const Spec *spec = again ? SECOND : &FIRST;
    Given given = {0};
    int64_t steps = 0;
    int reason;

    memset(m, 0, sizeof *m);
    reason = set_numbers(m, values);
    if (!reason)
        reason = set_start(m, values);
    if (reason)
        return reason;
    connect(m, m->out);
    given.steps = &taken;
    given.time = &went;
    given.again_steps = given.again_given_up = &nothing;
    while (!row_of(spec, &given, m->closing, w, &steps))
        ++spec;
    put_off(m->table, m->numbers, spec->draw);
    memcpy(x, m->x, sizeof x);
    if (again)
        start_beside(m, x);
    w[SLOT_T_END] = 1e300;
    m->state[LONGEST] = w[SLOT_H_MAX];
    begin_block(m, w, spec->n, INT64_MAX / 4, x);
    memcpy(m->out, x, sizeof m->out);
    m->state[LAST_EVENT] = -1.0;
    return 0;
}

/* Asks for one sample, and for a second one at the same time that finds no room. */
static void ask(double *block, double time, int last)
{
    block[AT_W / 8 + SLOT_SAMPLE_START] = time;
    block[AT_W / 8 + SLOT_SAMPLE_STEP] = 0.0;
    set_count(block, COUNT_NEXT_SAMPLE, 0);
    set_count(block, COUNT_ROWS, 0);
    set_count(block, COUNT_LAST_SAMPLE, last);
    set_count(block, COUNT_CAPACITY, 1);
}

#if EVENTS
/* Takes the step up to the event again, which writes the sample that lies in it. Returns whether it arrives. */
static int sample_before_event(Integration *m, double time)
{
    double *w = m->block + AT_W / 8;
    int k;

    ask(m->saved, time, 0);
    if (loop_trial_step((char *)m->places, m->state[EVENT_TIME], 0) != STATUS_DONE)
        return 0;
    for (k = 0; k < EVENTS; ++k)
        w[ARMED + k] = m->values[k];
    set_count(m->block, COUNT_WATCH, 1);
    return 1;
}

/* Notes where the loop has stopped: at an event, or where it goes on without one. Returns whether it finds neither. */
static int note_event(Integration *m)
{
    const int event = (int)counted(m->block, COUNT_EVENT), location = (int)counted(m->block, COUNT_LOCATED);

    m->state[EVENT_TIME] = m->block[AT_W / 8 + SLOT_T];
    m->state[AT_EVENT] = location;
    if (location == LOCATION_EVENT)
        m->state[ENDED] = EVENT[event].passed ? 0.0 : 1.0;
    if (location != LOCATION_NOTHING)
        m->state[LAST_EVENT] = event;
    return location == LOCATION_DOUBTFUL;
}
#endif

/* Sets where steps have to end: at the limit, or where formulas of time have another form behind. */
static void bound(Integration *m)
{
    const double *stretch = STRETCH_END + 3 * (int)m->state[STRETCH];
    double *w = m->block + AT_W / 8;

    w[SLOT_T_END] = stretch[0] < m->state[LIMIT] ? stretch[0] : m->state[LIMIT];
    w[SLOT_T_AFTER] = stretch[1];
    w[SLOT_T_BEFORE] = stretch[2];
}

/* Ends a motion whose integration has failed: it has no state any more. */
static int fail(Integration *m)
{
    int k;

    for (k = 0; k < NX; ++k)
        m->out[k] = (double)NAN;
    m->state[ENDED] = 2.0;
    return own_FAILED;
}

/* Goes to a time, or to the end of the motion before it; cut : whether a step ends there. */
static int go_on(Integration *m, double time, int cut)
{
    if (m->state[ENDED] == 2.0 || !(time >= m->state[TIME]) || time > KNOWN * (1.0 + 1e-9))
        return own_FAILED;
    connect(m, m->out);
    m->state[LIMIT] = cut ? time : 1e300;
    bound(m);
    for (;;) {
        int64_t status;
#if EVENTS
        if (m->state[AT_EVENT] != 0.0) {
            if (time < m->state[EVENT_TIME]) {
                if (!sample_before_event(m, time))
                    return fail(m);
                m->state[TIME] = time;
                return own_REACHED;
            }
            if (m->state[ENDED] != 0.0) {
                memcpy(m->out, (char *)m->block + AT_Y, sizeof m->out);
                m->state[TIME] = m->state[EVENT_TIME];
                return own_ENDED;
            }
            /* trial steps use the end for themselves */
            bound(m);
            set_count(m->block, COUNT_MAX_STEPS, INT64_MAX / 4);
            m->state[PASSED] += m->state[AT_EVENT] == LOCATION_EVENT;
            m->state[AT_EVENT] = 0.0;
        }
#endif
        ask(m->block, time, cut ? -1 : 1);
        status = loop_run_to_event((char *)m->places);
#if STRETCHES > 1
        if (status == STATUS_DONE && m->block[AT_W / 8 + SLOT_T_END] < m->state[LIMIT]) {
            m->state[STRETCH] += 1.0;
            bound(m);
            continue;
        }
#endif
        if (status == (cut ? STATUS_DONE : STATUS_FULL)) {
            if (cut)
                memcpy(m->out, (char *)m->block + AT_Y, sizeof m->out);
            m->state[TIME] = time;
            return own_REACHED;
        }
#if EVENTS
        if (status == STATUS_EVENT && !note_event(m))
            continue;
#endif
        return fail(m);
    }
}

/* Goes to a time at which a step ends. Where a controller samples there, what was before is kept: what is set there is
   what the sample sees. */
static int go_to_stop(Integration *m, double time)
{
#if BEGUN
    double *w = m->block + AT_W / 8;
    const double number = floor(time / UPDATE[0] + 0.5), before = (number - 1.0) * UPDATE[0] + UPDATE[1];
    double instant;
    int reached;

    m->state[SAMPLED] = 0.0;
    if (number < 1.0 || fabs(number * UPDATE[0] - time) > 4e-16 * time)
        return go_on(m, time, 1);
    if (before > m->state[TIME]) {
        reached = go_on(m, before, 1);
        if (reached != own_REACHED)
            return reached;
    }
    instant = w[SLOT_NEXT_UPDATE];
    if (instant <= time * (1.0 + 4e-16)) {
        w[SLOT_NEXT_UPDATE] = 1e300;
        reached = go_on(m, time, 1);
        w[SLOT_NEXT_UPDATE] = instant;
        if (reached != own_REACHED)
            return reached;
        memcpy(m->before, m->block, sizeof m->block);
        m->state[SAMPLED] = 1.0;
    }
#endif
    return go_on(m, time, 1);
}

int own_loop_to(own_loop *loop, double time, double x[own_STATES])
{
    Integration *m = (Integration *)(void *)loop->memory;
    const int reached = go_on(m, time, 0);

    memcpy(x, m->out, sizeof m->out);
    return reached;
}

int own_loop_stop(own_loop *loop, double time, double longest, double x[own_STATES])
{
    Integration *m = (Integration *)(void *)loop->memory;
    int reached;

    if (longest < m->state[LONGEST])
        m->block[AT_W / 8 + SLOT_H_MAX] = longest;
    else
        m->block[AT_W / 8 + SLOT_H_MAX] = m->state[LONGEST];
    reached = go_to_stop(m, time);
    memcpy(x, m->out, sizeof m->out);
    return reached;
}

int own_loop_change(own_loop *loop, const double values[own_KEY_ROOM], int again)
{
    Integration *m = (Integration *)(void *)loop->memory;
    int reason = set_numbers(m, values);

    if (!reason)
        reason = no_bodies(m, m->out);
    if (!reason)
        put_off(m->table, m->numbers, again ? SECOND[0].draw : FIRST.draw);
#if BEGUN
    if (!reason && m->state[TIME] == 0.0) {
        first_sample(m);
        memcpy((char *)m->block + AT_Y + 8 * FIRST_BEGUN, m->x + FIRST_BEGUN, BEGUN * sizeof(double));
        memcpy(m->out + FIRST_BEGUN, m->x + FIRST_BEGUN, BEGUN * sizeof(double));
    } else if (!reason && m->state[SAMPLED] != 0.0) {
        memcpy(m->block, m->before, sizeof m->block);
        go_on(m, m->state[TIME], 1);
    }
#endif
    return reason;
}

void own_loop_state(const own_loop *loop, double x[own_STATES])
{
    memcpy(x, ((const Integration *)(const void *)loop->memory)->out, own_STATES * sizeof(double));
}

#if OBSERVED
void own_loop_outputs(own_loop *loop, double time, const double x[own_STATES], double out[OBSERVED + REACTIONS])
{
    Integration *m = (Integration *)(void *)loop->memory;

    memcpy(m->observed, x, NX * sizeof(double));
    m->observed[NX] = time;
    loop_outputs((char *)m->observed, (char *)m->table, (char *)(m->observed + NX + 1));
#if REACTIONS
    loop_reactions((char *)m->observed, (char *)m->table, (char *)(m->observed + NX + 1 + OBSERVED));
#endif
    memcpy(out, m->observed + NX + 1, (OBSERVED + REACTIONS) * sizeof(double));
}
#endif

double own_loop_time(const own_loop *loop)
{
    return ((const Integration *)(const void *)loop->memory)->state[TIME];
}

int own_loop_steps(const own_loop *loop)
{
    return (int)counted(((const Integration *)(const void *)loop->memory)->block, COUNT_ACCEPTED);
}

int own_loop_passed(const own_loop *loop)
{
    return (int)((const Integration *)(const void *)loop->memory)->state[PASSED];
}

int own_loop_last_event(const own_loop *loop)
{
    return (int)((const Integration *)(const void *)loop->memory)->state[LAST_EVENT];
}

/* ---- whole motions with their errors ------------------------------------------------------------------------------ */

typedef struct {
    double time, steps, given_up, end[NX];
    int event, arrived, status;
    int64_t samples;
} Made;

/* Makes one motion; out : its samples, a column a state. */
static void drive(Judging *j, const Spec *spec, const double *w, int64_t steps, const double *x, double *out, Made *made)
{
    Integration *m = &j->run;
    char *job[JOBS] = {0};
    int64_t status = -1;
    int k;

    memcpy(j->w, w, sizeof j->w);
    for (k = 0; k < N_COUNT; ++k)
        store_l((char *)(j->n + k), spec->n[k]);
    store_l((char *)(j->n + COUNT_MAX_STEPS), steps);
    memcpy(j->y, x, sizeof j->y);
    memcpy(j->p, PARAMETER, sizeof j->p);
    put_off(m->table, j->numbers, spec->draw);
    memset(j->clear, 0, sizeof j->clear);
    memset(m->work, 0, sizeof m->work);
    connect(m, out);
    job[JOB_stop] = (char *)j->stop;
    job[JOB_clear] = (char *)j->clear;
    job[JOB_stretches] = (char *)(uintptr_t)STRETCH_END;
    job[JOB_all_w] = (char *)j->w;
    job[JOB_all_n] = (char *)j->n;
    job[JOB_all_y] = (char *)j->y;
    job[JOB_all_p] = (char *)j->p;
    job[JOB_all_numbers] = (char *)j->numbers;
    job[JOB_all_out] = (char *)out;
    job[JOB_all_status] = (char *)&status;
    store_l((char *)j->stop, 0);
    for (k = 0; k < JOBS; ++k)
        store_p((char *)(j->job + k), job[k]);
    store_l((char *)(j->job + JOB_events), EVENTS);
    store_l((char *)(j->job + JOB_passing), PASSING);
    store_l((char *)(j->job + JOB_stops), STRETCHES);
    store_l((char *)(j->job + JOB_bytes_w), sizeof j->w);
    store_l((char *)(j->job + JOB_bytes_n), sizeof j->n);
    store_l((char *)(j->job + JOB_bytes_y), sizeof j->y);
    store_l((char *)(j->job + JOB_bytes_p), sizeof j->p);
    store_l((char *)(j->job + JOB_bytes_numbers), OWN * sizeof(double));
    store_l((char *)(j->job + JOB_bytes_out), 0);
    loop_many((char *)m->places, (char *)j->job, 0, 1);
    made->time = j->w[SLOT_T];
    made->steps = (double)load_l((char *)(j->n + COUNT_ACCEPTED));
    made->status = (int)status;
    made->given_up = status == STATUS_MAX_STEPS;
    made->event = -1;
    if (status == STATUS_EVENT && load_l((char *)(j->n + COUNT_LOCATED)) == LOCATION_EVENT)
        made->event = (int)load_l((char *)(j->n + COUNT_EVENT));
    memcpy(made->end, j->y, sizeof j->y);
    made->samples = load_l((char *)(j->n + COUNT_NEXT_SAMPLE)) - 1;
    if (made->samples > spec->n[COUNT_LAST_SAMPLE])
        made->samples = spec->n[COUNT_LAST_SAMPLE];
#if LOCKS
    made->arrived = made->event >= 0 && EVENT[made->event].dead;
#else
    made->arrived = status == STATUS_DONE;
#endif
    made->arrived = made->arrived && all_finite(made->end);
}

/* Makes the last of several integrations that is made. Returns whether it arrives. */
static int drive_again(Judging *j, const Spec *specs, int count, const double *x, const Made *first, double *out, Made *made)
{
    double w[W_COUNT], steps = 0.0, given_up = 0.0;
    Given given = {0};
    int k, begun = 0;

    made->arrived = 0;
    given.steps = &first->steps;
    given.time = &first->time;
    given.again_steps = &steps;
    given.again_given_up = &given_up;
    for (k = 0; k < count; ++k) {
        int64_t allowed;
        if (!row_of(&specs[k], &given, j->scratch, w, &allowed))
            continue;
        drive(j, &specs[k], w, allowed, x, out, made);
        if (begun)
            continue;
        begun = 1;
        /* what failed otherwise than by its number of steps is not made once more */
        steps = made->arrived ? made->steps : HUGE_VAL;
        given_up = made->given_up;
    }
    return made->arrived;
}

#if LOCKS || BALANCE || SLOW
static int holds(Judging *j, const Given *given, void (*rule)(const Given *, Judged *, double *))
{
    Judged judged = {0};

    rule(given, &judged, j->scratch);
    return judged.good[0] != 0.0;
}
#endif

/* Takes all numbers out of a result: one that is left to robodyn has none. */
static int without(own_loop_result *result, int reason)
{
    int k;

    result->time = result->time_error = (double)NAN;
    for (k = 0; k < NQ; ++k)
        result->q[k] = result->q_error[k] = (double)NAN;
    for (k = 0; k < NV; ++k)
        result->qd[k] = result->qd_error[k] = (double)NAN;
    result->event = -1;
    return reason;
}

static void fill(own_loop_result *result, const Made *first, const double *errors)
{
    int k;

    for (k = 0; k < NQ; ++k) {
        result->q[k] = first->end[Q_PLACE[k]];
        result->q_error[k] = errors[Q_PLACE[k]];
    }
    for (k = 0; k < NV; ++k) {
        result->qd[k] = first->end[V_PLACE[k]];
        result->qd_error[k] = errors[V_PLACE[k]];
    }
}

/* Samples, rows of states from the start to the end. Returns how many. */
static int keep_samples(const double *start, const double *out, int64_t samples, const Made *first, double *rows)
{
    int64_t n;
    int k, count = 1;

    memcpy(rows, start, NX * sizeof(double));
    for (n = EVERY - 1; n < samples; n += EVERY, ++count)
        for (k = 0; k < NX; ++k)
            rows[count * NX + k] = out[k * SAMPLES + n];
    memcpy(rows + (count > SHOWN ? SHOWN : count) * NX, first->end, NX * sizeof(double));
    return (count > SHOWN ? SHOWN : count) + 1;
}

#if LOCKS
static int judge_lock(Judging *j, const Made *first, own_loop_result *result, double *samples)
{
    double beside[NX], w[W_COUNT];
    Given given = {0};
    Judged judged = {0};
    Made second, picture;
    int64_t steps = 0;

    loop_psi((char *)(uintptr_t)first->end, (char *)j->run.table, (char *)j->run.results);
    given.psi = j->run.results;
    if (!holds(j, &given, rule_regular_lock))
        return REASON_regular_lock;
    start_beside(&j->run, beside);
    if (!drive_again(j, SECOND, SECONDS, beside, first, j->again_out, &second))
        return REASON_second;
    given.steps = &first->steps;
    given.time = &first->time;
    given.first_end = first->end;
    given.again_time = &second.time;
    given.again_steps = &second.steps;
    given.again_end = second.end;
    rule_lock(&given, &judged, j->scratch);
    if (judged.good[0] == 0.0)
        return REASON_lock;
    result->time_error = judged.time_error[0];
    result->second_steps = (int)second.steps;
    fill(result, first, judged.end);
    if (samples) {
        Given of_picture = {0};
        of_picture.time = &first->time;
        row_of(&PICTURE, &of_picture, j->scratch, w, &steps);
        drive(j, &PICTURE, w, steps, j->run.x, j->first_out, &picture);
        result->samples = keep_samples(j->run.x, j->first_out, picture.samples, first, samples);
    }
    return 0;
}
#else
static int judge_end(Judging *j, const Made *first, own_loop_result *result, double *samples)
{
    Made second;
    Given given = {0};
    Judged judged = {0};
#if THIRDS
    Made third;
#endif

#if BALANCE
    {
        Given balance = {0};
        const double work = WORK < 0 ? 0.0 : first->end[WORK < 0 ? 0 : WORK];
        double energies[4];
        loop_energies((char *)j->run.x, (char *)j->run.table, (char *)energies);
        loop_energies((char *)(uintptr_t)first->end, (char *)j->run.table, (char *)(energies + 2));
        balance.energies_start = energies;
        balance.energies_end = energies + 2;
        balance.steps = &first->steps;
        balance.work = &work;
        if (!holds(j, &balance, rule_balance))
            return REASON_balance;
    }
#endif
    if (!drive_again(j, SECOND, SECONDS, j->run.x, first, j->again_out, &second))
        return REASON_second;
    given.start = j->run.x;
    given.steps = &first->steps;
    given.time = &first->time;
    given.first_out = j->first_out;
    given.first_end = first->end;
    given.again_out = j->again_out;
    given.again_end = second.end;
    given.again_steps = &second.steps;
    /* a third tells what other roundings do */
#if THIRDS
    if (drive_again(j, THIRD, THIRDS, j->run.x, first, j->third_out, &third)) {
        given.third_out = j->third_out;
        given.third_end = third.end;
        rule_errors_third(&given, &judged, j->scratch);
    } else
#endif
        rule_errors_second(&given, &judged, j->scratch);
    result->time_error = 0.0;
    result->second_steps = (int)second.steps;
    fill(result, first, judged.end);
    if (samples)
        result->samples = keep_samples(j->run.x, j->first_out, first->samples, first, samples);
    return 0;
}
#endif

int own_loop_run(own_loop_room *room, const double values[own_KEY_ROOM], own_loop_result *result, double *samples)
{
    Judging *j = (Judging *)(void *)room->memory;
    double w[W_COUNT];
    Given given = {0};
    Made first;
    int64_t steps = 0;
    int reason;

    memset(result, 0, sizeof *result);
    memset(&j->run, 0, sizeof j->run);
    result->event = -1;
    reason = set_numbers(&j->run, values);
    if (!reason)
        reason = set_start(&j->run, values);
    if (reason)
        return without(result, reason);
#if SLOW
    loop_jacobian((char *)j->run.x, (char *)j->run.table, (char *)j->run.results);
    given.jacobian = j->run.results;
    if (!holds(j, &given, rule_slow))
        return without(result, REASON_slow);
#endif
#if LOCKS
    loop_psi((char *)j->run.x, (char *)j->run.table, (char *)j->run.results);
    given.psi = j->run.results;
    if (!holds(j, &given, rule_regular_start))
        return without(result, REASON_regular_start);
#endif
    row_of(&FIRST, &given, j->scratch, w, &steps);
    drive(j, &FIRST, w, steps, j->run.x, j->first_out, &first);
    result->time = first.time;
    result->steps = (int)first.steps;
    result->event = first.event;
    if (!first.arrived)
        return without(result, LOCKS && first.status == STATUS_DONE ? REASON_no_lock : REASON_ended);
#if LOCKS
    reason = judge_lock(j, &first, result, samples);
#else
    reason = judge_end(j, &first, result, samples);
#endif
    return reason ? without(result, reason) : 0;
}
