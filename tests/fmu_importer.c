/* Drives a unit of FMI 3.0 as other tools do: loaded at run time, with declarations of its own.

   importer LIBRARY TOKEN STEP COUNT FIRST OUTPUTS [KEY=VALUE]...

   Makes steps, reads so many outputs from value reference FIRST on at each, and prints them at the end with the time that
   was reached. Half-way it keeps the state twice, in memory and as bytes, goes on, comes back to each and goes on again:
   all three have to end alike. KEY is a value reference; one behind "@" is set before the second half. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

enum { MOST = 400 };

typedef void *Unit;
typedef int (*Plain)(Unit);
typedef int (*Get)(Unit, const uint32_t *, size_t, double *, size_t);
typedef int (*Set)(Unit, const uint32_t *, size_t, const double *, size_t);
typedef int (*Step)(Unit, double, double, bool, bool *, bool *, bool *, double *);
typedef void (*Log)(void *, int, const char *, const char *);
typedef Unit (*Make)(const char *, const char *, const char *, bool, bool, bool, bool, const uint32_t *, size_t, void *,
                     Log, void *);
typedef int (*Enter)(Unit, bool, double, double, bool, double);
typedef int (*Keep)(Unit, void **);
typedef int (*Back)(Unit, void *);
typedef int (*Size)(Unit, void *, size_t *);
typedef int (*Write)(Unit, void *, uint8_t *, size_t);
typedef int (*Read)(Unit, const uint8_t *, size_t, void **);

static void *library;
static Step step_on;
static Get get;
static uint32_t references[MOST];
static size_t outputs;
static double values[MOST];

static void check(int status, const char *what)
{
    if (status) {
        fprintf(stderr, "%s: status %d\n", what, status);
        exit(1);
    }
}

static void tell(void *environment, int status, const char *category, const char *message)
{
    (void)environment;
    fprintf(stderr, "%s %d: %s\n", category, status, message);
}

static void find(const char *name, void *function)
{
    void *found = dlsym(library, name);

    if (!found) {
        fprintf(stderr, "there is no %s\n", name);
        exit(1);
    }
    memcpy(function, &found, sizeof found);
}

/* Makes steps until the unit ends the simulation. Returns the time that was reached. */
static double go_on(Unit unit, double step, long from, long to)
{
    double reached = from * step;
    long k;

    for (k = from; k < to; ++k) {
        bool event, terminate, early;
        check(step_on(unit, k * step, step, false, &event, &terminate, &early, &reached), "fmi3DoStep");
        check(get(unit, references, outputs, values, outputs), "fmi3GetFloat64");
        if (terminate)
            break;
    }
    return reached;
}

static void set_key(Set set, Unit unit, const char *text)
{
    const uint32_t reference = (uint32_t)strtoul(text, NULL, 10);
    const double value = strtod(strchr(text, '=') + 1, NULL);

    check(set(unit, &reference, 1, &value, 1), "fmi3SetFloat64");
}

int main(int count, char **words)
{
    const double step = strtod(words[3], NULL);
    const long steps = strtol(words[4], NULL, 10), half = steps / 2;
    double kept[MOST], reached;
    void *state = NULL, *other = NULL;
    uint8_t *bytes;
    size_t size, k;
    int i, way;
    clock_t begun;
    Make make;
    Plain leave, end, release;
    Enter enter;
    Set set;
    Keep keep, drop;
    Back back;
    Size measure;
    Write write;
    Read read;
    Unit unit;

    outputs = strtoul(words[6], NULL, 10);
    for (k = 0; k < outputs; ++k)
        references[k] = (uint32_t)(strtoul(words[5], NULL, 10) + k);
    library = dlopen(words[1], RTLD_NOW | RTLD_LOCAL);
    if (!library) {
        fprintf(stderr, "%s\n", dlerror());
        return 1;
    }
    find("fmi3InstantiateCoSimulation", &make);
    find("fmi3EnterInitializationMode", &enter);
    find("fmi3ExitInitializationMode", &leave);
    find("fmi3SetFloat64", &set);
    find("fmi3GetFloat64", &get);
    find("fmi3DoStep", &step_on);
    find("fmi3GetFMUState", &keep);
    find("fmi3SetFMUState", &back);
    find("fmi3FreeFMUState", &drop);
    find("fmi3SerializedFMUStateSize", &measure);
    find("fmi3SerializeFMUState", &write);
    find("fmi3DeserializeFMUState", &read);
    find("fmi3Terminate", &end);
    find("fmi3FreeInstance", &release);
    if (make("own", "another token", "", false, true, false, false, NULL, 0, NULL, NULL, NULL))
        return 2;
    unit = make("own", words[2], "", false, true, false, false, NULL, 0, NULL, tell, NULL);
    if (!unit)
        return 1;
    for (i = 7; i < count; ++i)
        if (words[i][0] != '@')
            set_key(set, unit, words[i]);
    check(enter(unit, false, 0.0, 0.0, false, 0.0), "fmi3EnterInitializationMode");
    check(leave(unit), "fmi3ExitInitializationMode");
    begun = clock();
    go_on(unit, step, 0, half);
    check(keep(unit, &state), "fmi3GetFMUState");
    check(measure(unit, state, &size), "fmi3SerializedFMUStateSize");
    bytes = malloc(size);
    check(write(unit, state, bytes, size), "fmi3SerializeFMUState");
    for (way = 0; way < 3; ++way) {
        for (i = 7; i < count; ++i)
            if (words[i][0] == '@')
                set_key(set, unit, words[i] + 1);
        reached = go_on(unit, step, half, steps);
        if (way == 0)
            printf("%.9g\n", (double)(clock() - begun) / CLOCKS_PER_SEC);
        if (way && memcmp(kept, values, outputs * sizeof(double)) != 0)
            return 3;
        memcpy(kept, values, sizeof kept);
        if (way == 0) {
            check(back(unit, state), "fmi3SetFMUState");
        } else if (way == 1) {
            check(read(unit, bytes, size, &other), "fmi3DeserializeFMUState");
            check(back(unit, other), "fmi3SetFMUState");
        }
    }
    printf("%.17g\n", reached);
    for (k = 0; k < outputs; ++k)
        printf("%.17g\n", values[k]);
    check(drop(unit, &state), "fmi3FreeFMUState");
    check(drop(unit, &other), "fmi3FreeFMUState");
    free(bytes);
    check(end(unit), "fmi3Terminate");
    release(unit);
    return 0;
}
