/* An FMU of FMI 2.0 and 3.0, for model exchange and co-simulation; what it computes stands in model.h (fmus.py). */
#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include "model.h"
#define E __attribute__((visibility("default")))
#define M(i) ((unit *)(i))

typedef void (*logger2)(void *, const char *, int, const char *, const char *, ...);
typedef struct {
    double v[VALUES], z[INDICATORS + 1], t, next;
    int changed, ended;
    logger2 log;
} unit;

typedef struct { int again, stop, nominals, values, defined; double next; } info;
typedef void (*logger3)(void *, int, const char *, const char *);
typedef struct { logger2 log; void *(*get)(size_t, size_t); void (*free)(void *); void *done; void *of; } calls;

static inline void say(unit *m, const char *what)
{
    if (m->log != 0) m->log(0, "unit", 3, "error", "%s", what);
}

static void compute(unit *m) { RATES }
static void indicate(unit *m) { (void)m; INDICATE }
static void happen(unit *m) { (void)m; EVENT }

static unit *made(void)
{
    static const double start[VALUES] = STARTS;
    unit *m = calloc(1, sizeof *m);
    memcpy(m->v, start, sizeof start);
    m->next = NEXT;
    return m;
}

static int step(unit *m, double h)
{
    const int n = 1 + (int)ceil(h / 1e-4);
    for (int k = 0; k < n; k++) {
        compute(m);
        for (int j = 0; j < STATES; j++) m->v[j] += h / n * m->v[STATES + j];
        m->t += h / n;
    }
    return 0;
}

static int get(unit *m, const uint32_t *r, size_t n, double *to)
{
    compute(m);
    for (size_t k = 0; k < n; k++) to[k] = m->v[r[k]];
    return 0;
}

static int set(unit *m, const uint32_t *r, size_t n, const double *from)
{
    for (size_t k = 0; k < n; k++) m->v[r[k]] = from[k];
    REFUSE
    return 0;
}

static void updated(unit *m)
{
    m->changed = 0;
    happen(m);
}

E const char *fmi2GetTypesPlatform(void) { return "default"; }
E const char *fmi2GetVersion(void) { return "2.0"; }
E int fmi2SetDebugLogging(void *i, int on, size_t n, const char *const c[]) { (void)i, (void)on, (void)n, (void)c; return 0; }
E void *fmi2Instantiate(const char *name, int type, const char *guid, const char *where, const calls *f, int seen, int logs)
{
    (void)type, (void)guid, (void)where, (void)seen, (void)logs;
    if (LICENSE) { f->log(f->of, name, 3, "error", "no license of %s found", name); return 0; }
    unit *m = made();
    m->log = f->log;
    return m;
}
E void fmi2FreeInstance(void *i) { free(i); }
E int fmi2SetupExperiment(void *i, int a, double b, double t, int c, double d) { (void)a, (void)b, (void)c, (void)d; M(i)->t = t; return 0; }
E int fmi2EnterInitializationMode(void *i) { (void)i; return 0; }
E int fmi2ExitInitializationMode(void *i) { unit *m = M(i); (void)m; INITIAL return 0; }
E int fmi2Terminate(void *i) { (void)i; return 0; }
E int fmi2Reset(void *i) { unit *m = made(); memcpy(i, m, sizeof *m); free(m); return 0; }
E int fmi2GetReal(void *i, const uint32_t r[], size_t n, double v[]) { return get(i, r, n, v); }
E int fmi2SetReal(void *i, const uint32_t r[], size_t n, const double v[]) { return set(i, r, n, v); }
#define NONE(name, type) \
    E int fmi2Get##name(void *i, const uint32_t r[], size_t n, type v[]) { (void)i, (void)r, (void)v; return n ? 3 : 0; } \
    E int fmi2Set##name(void *i, const uint32_t r[], size_t n, const type v[]) { (void)i, (void)r, (void)v; return n ? 3 : 0; }
NONE(Integer, int) NONE(Boolean, int) NONE(String, char *)
E int fmi2EnterEventMode(void *i) { (void)i; return 0; }
E int fmi2NewDiscreteStates(void *i, info *to)
{
    updated(i);
    *to = (info){0, M(i)->ended, 0, M(i)->changed, isfinite(M(i)->next), M(i)->next};
    return 0;
}
E int fmi2EnterContinuousTimeMode(void *i) { (void)i; return 0; }
E int fmi2CompletedIntegratorStep(void *i, int a, int *event, int *stop) { (void)i, (void)a; *event = *stop = 0; return 0; }
E int fmi2SetTime(void *i, double t) { M(i)->t = t; return 0; }
E int fmi2SetContinuousStates(void *i, const double x[], size_t n) { memcpy(M(i)->v, x, n * sizeof *x); return 0; }
E int fmi2GetContinuousStates(void *i, double x[], size_t n) { memcpy(x, M(i)->v, n * sizeof *x); return 0; }
E int fmi2GetNominalsOfContinuousStates(void *i, double x[], size_t n) { (void)i; for (size_t k = 0; k < n; k++) x[k] = 1.0; return 0; }
E int fmi2GetDerivatives(void *i, double dx[], size_t n)
{
    unit *m = M(i);
    compute(m);
    memcpy(dx, m->v + STATES, n * sizeof *dx);
    CRASH
    return 0;
}
E int fmi2GetEventIndicators(void *i, double z[], size_t n) { compute(i); indicate(i); memcpy(z, M(i)->z, n * sizeof *z); return 0; }
E int fmi2DoStep(void *i, double t, double h, int last) { (void)t, (void)last; return step(i, h); }
E int fmi2GetDirectionalDerivative(void *i, const uint32_t of[], size_t ofs, const uint32_t by[], size_t bys, const double s[], double v[])
{
    unit one = *M(i), other = one; /* exact for what is linear */
    for (size_t k = 0; k < bys; k++) one.v[by[k]] += s[k];
    compute(&one), compute(&other);
    for (size_t k = 0; k < ofs; k++) v[k] = one.v[of[k]] - other.v[of[k]];
    return 0;
}
E int fmi2GetFMUstate(void *i, void **s) { (void)i, (void)s; return 3; }
E int fmi2SetFMUstate(void *i, void *s) { (void)i, (void)s; return 3; }
E int fmi2FreeFMUstate(void *i, void **s) { (void)i, (void)s; return 0; }
E int fmi2SerializedFMUstateSize(void *i, void *s, size_t *n) { (void)i, (void)s, (void)n; return 3; }
E int fmi2SerializeFMUstate(void *i, void *s, char *b, size_t n) { (void)i, (void)s, (void)b, (void)n; return 3; }
E int fmi2DeSerializeFMUstate(void *i, const char *b, size_t n, void **s) { (void)i, (void)s, (void)b, (void)n; return 3; }
E int fmi2SetRealInputDerivatives(void *i, const uint32_t r[], size_t n, const int o[], const double v[]) { (void)i, (void)r, (void)n, (void)o, (void)v; return 3; }
E int fmi2GetRealOutputDerivatives(void *i, const uint32_t r[], size_t n, const int o[], double v[]) { (void)i, (void)r, (void)n, (void)o, (void)v; return 3; }
E int fmi2CancelStep(void *i) { (void)i; return 3; }
E int fmi2GetStatus(void *i, int k, int *v) { (void)i, (void)k, (void)v; return 2; }
E int fmi2GetRealStatus(void *i, int k, double *v) { (void)i, (void)k, (void)v; return 2; }
E int fmi2GetIntegerStatus(void *i, int k, int *v) { (void)i, (void)k, (void)v; return 2; }
E int fmi2GetBooleanStatus(void *i, int k, int *v) { (void)i, (void)k, (void)v; return 2; }
E int fmi2GetStringStatus(void *i, int k, const char **v) { (void)i, (void)k, (void)v; return 2; }

E const char *fmi3GetVersion(void) { return "3.0"; }
E int fmi3SetDebugLogging(void *i, bool on, size_t n, const char *const c[]) { (void)i, (void)on, (void)n, (void)c; return 0; }
static void *instance3(const char *name, void *of, logger3 log)
{
    (void)name;
    if (LICENSE) { log(of, 3, "error", "no license found"); return 0; }
    return made();
}
E void *fmi3InstantiateModelExchange(const char *name, const char *token, const char *where, bool seen, bool logs, void *of, logger3 log)
{
    (void)token, (void)where, (void)seen, (void)logs;
    return instance3(name, of, log);
}
E void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *where, bool seen, bool logs, bool events,
                                    bool early, const uint32_t *r, size_t n, void *of, logger3 log, void *update)
{
    (void)token, (void)where, (void)seen, (void)logs, (void)events, (void)early, (void)r, (void)n, (void)update;
    return instance3(name, of, log);
}
E void fmi3FreeInstance(void *i) { free(i); }
E int fmi3EnterInitializationMode(void *i, bool a, double b, double t, bool c, double d) { (void)a, (void)b, (void)c, (void)d; M(i)->t = t; return 0; }
E int fmi3ExitInitializationMode(void *i) { unit *m = M(i); (void)m; INITIAL return 0; }
E int fmi3Terminate(void *i) { (void)i; return 0; }
E int fmi3Reset(void *i) { return fmi2Reset(i); }
E int fmi3GetFloat64(void *i, const uint32_t r[], size_t n, double v[], size_t k) { (void)k; return get(i, r, n, v); }
E int fmi3SetFloat64(void *i, const uint32_t r[], size_t n, const double v[], size_t k) { (void)k; return set(i, r, n, v); }
E int fmi3EnterEventMode(void *i) { (void)i; return 0; }
E int fmi3UpdateDiscreteStates(void *i, bool *again, bool *stop, bool *nominals, bool *values, bool *defined, double *next)
{
    updated(i);
    *again = *nominals = false, *stop = M(i)->ended, *values = M(i)->changed;
    *defined = isfinite(M(i)->next), *next = M(i)->next;
    return 0;
}
E int fmi3EnterContinuousTimeMode(void *i) { (void)i; return 0; }
E int fmi3CompletedIntegratorStep(void *i, bool a, bool *event, bool *stop) { (void)i, (void)a; *event = *stop = false; return 0; }
E int fmi3SetTime(void *i, double t) { M(i)->t = t; return 0; }
E int fmi3SetContinuousStates(void *i, const double x[], size_t n) { return fmi2SetContinuousStates(i, x, n); }
E int fmi3GetContinuousStates(void *i, double x[], size_t n) { return fmi2GetContinuousStates(i, x, n); }
E int fmi3GetNominalsOfContinuousStates(void *i, double x[], size_t n) { return fmi2GetNominalsOfContinuousStates(i, x, n); }
E int fmi3GetContinuousStateDerivatives(void *i, double dx[], size_t n) { return fmi2GetDerivatives(i, dx, n); }
E int fmi3GetEventIndicators(void *i, double z[], size_t n) { return fmi2GetEventIndicators(i, z, n); }
E int fmi3GetNumberOfEventIndicators(void *i, size_t *n) { (void)i; *n = INDICATORS; return 0; }
E int fmi3GetNumberOfContinuousStates(void *i, size_t *n) { (void)i; *n = STATES; return 0; }
E int fmi3EnterStepMode(void *i) { (void)i; return 0; }
E int fmi3DoStep(void *i, double t, double h, bool last, bool *event, bool *stop, bool *early, double *at)
{
    (void)last, *event = *stop = *early = false, *at = t + h;
    return step(i, h);
}

#define NO(name) E int name(void) { return 3; } /* what such a unit has not */
NO(fmi3ActivateModelPartition) NO(fmi3DeserializeFMUState) NO(fmi3EnterConfigurationMode)
NO(fmi3EvaluateDiscreteStates) NO(fmi3ExitConfigurationMode) NO(fmi3FreeFMUState) NO(fmi3GetAdjointDerivative)
NO(fmi3GetBinary) NO(fmi3GetBoolean) NO(fmi3GetClock) NO(fmi3GetDirectionalDerivative) NO(fmi3GetFMUState)
NO(fmi3GetFloat32) NO(fmi3GetInt16) NO(fmi3GetInt32) NO(fmi3GetInt64) NO(fmi3GetInt8) NO(fmi3GetIntervalDecimal)
NO(fmi3GetIntervalFraction) NO(fmi3GetNumberOfVariableDependencies) NO(fmi3GetOutputDerivatives)
NO(fmi3GetShiftDecimal) NO(fmi3GetShiftFraction) NO(fmi3GetString) NO(fmi3GetUInt16) NO(fmi3GetUInt32)
NO(fmi3GetUInt64) NO(fmi3GetUInt8) NO(fmi3GetVariableDependencies) NO(fmi3InstantiateScheduledExecution)
NO(fmi3SerializeFMUState) NO(fmi3SerializedFMUStateSize) NO(fmi3SetBinary) NO(fmi3SetBoolean) NO(fmi3SetClock)
NO(fmi3SetFMUState) NO(fmi3SetFloat32) NO(fmi3SetInt16) NO(fmi3SetInt32) NO(fmi3SetInt64) NO(fmi3SetInt8)
NO(fmi3SetIntervalDecimal) NO(fmi3SetIntervalFraction) NO(fmi3SetShiftDecimal) NO(fmi3SetShiftFraction)
NO(fmi3SetString) NO(fmi3SetUInt16) NO(fmi3SetUInt32) NO(fmi3SetUInt64) NO(fmi3SetUInt8)
