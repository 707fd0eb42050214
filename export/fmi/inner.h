/* An FMU for model exchange within this one: its library lies in resources/inner, its rates and outputs are asked for. */
#ifndef INNER_H
#define INNER_H

#include <dlfcn.h>
#include <math.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { INNER_PATH = 4096, INNER_ROUNDS = 100, INNER_FINE = 1 };

/* What is known of it: references and (factor, level) of this model's numbers over its own. */
typedef struct
{
    const char *token;
    const char *library;
    int states, inputs, parameters, outputs;
    const unsigned *input, *parameter, *output;
    const double (*state_scale)[2], (*input_scale)[2], (*parameter_scale)[2], (*output_scale)[2];
} inner_about;

typedef struct
{
    void *library, *component;
    int (*set_time)(void *, double);
    int (*set_states)(void *, const double *, size_t);
    int (*get_states)(void *, double *, size_t);
    int (*get_rates)(void *, double *, size_t);
    void (*end)(void *);
#if INNER_FMI == 3
    int (*set)(void *, const unsigned *, size_t, const double *, size_t);
    int (*get)(void *, const unsigned *, size_t, double *, size_t);
#else
    int (*set)(void *, const unsigned *, size_t, const double *);
    int (*get)(void *, const unsigned *, size_t, double *);
#endif
    double own[INNER_NUMBERS], rate[INNER_NUMBERS];
} inner;

static void inner_close(void *i)
{
    inner *of = (inner *)i;
    if (of != 0)
    {
        if ((of->component != 0) && (of->end != 0))
        {
            of->end(of->component);
        }
        if (of->library != 0)
        {
            (void)dlclose(of->library);
        }
        free(of);
    }
}

static int inner_set(inner *i, const unsigned *reference, int count, const double (*scale)[2], const double *value)
{
    for (int k = 0; k < count; k++)
    {
        i->own[k] = (value[k] - scale[k][1]) / scale[k][0];
    }
#if INNER_FMI == 3
    return (count == 0) ? 0 : i->set(i->component, reference, (size_t)count, i->own, (size_t)count);
#else
    return (count == 0) ? 0 : i->set(i->component, reference, (size_t)count, i->own);
#endif
}

/* Time, states and inputs: 0 where it takes them. */
static int inner_place(inner *i, const inner_about *a, double time, const double *x, const double *u)
{
    int status = i->set_time(i->component, time);
    int worst = (status > INNER_FINE);
    for (int j = 0; j < a->states; j++)
    {
        i->own[j] = (x[j] - a->state_scale[j][1]) / a->state_scale[j][0];
    }
    status = (a->states == 0) ? 0 : i->set_states(i->component, i->own, (size_t)a->states);
    worst |= (status > INNER_FINE);
    return worst | (inner_set(i, a->input, a->inputs, a->input_scale, u) > INNER_FINE);
}

/* Add its rates to `dx`; none is a number where it refuses. */
static void inner_rates(void *of, const inner_about *a, double time, const double *x, const double *u, double *dx)
{
    inner *i = (inner *)of;
    const int bad = (i == 0) || (inner_place(i, a, time, x, u) != 0) ||
                    ((a->states > 0) && (i->get_rates(i->component, i->rate, (size_t)a->states) > INNER_FINE));
    for (int j = 0; j < a->states; j++)
    {
        dx[j] += bad ? (double)NAN : (a->state_scale[j][0] * i->rate[j]);
    }
}

/* Its outputs that are no states. */
static void inner_outputs(void *of, const inner_about *a, double time, const double *x, const double *u, double *y)
{
    inner *i = (inner *)of;
    int bad = (i == 0) || (inner_place(i, a, time, x, u) != 0);
    if (!bad && (a->outputs > 0))
    {
#if INNER_FMI == 3
        bad = i->get(i->component, a->output, (size_t)a->outputs, i->own, (size_t)a->outputs) > INNER_FINE;
#else
        bad = i->get(i->component, a->output, (size_t)a->outputs, i->own) > INNER_FINE;
#endif
    }
    for (int k = 0; k < a->outputs; k++)
    {
        y[k] = bad ? (double)NAN : ((a->output_scale[k][0] * i->own[k]) + a->output_scale[k][1]);
    }
}

/* The folder of resources/inner, beside the folder of this library; empty where it is not found. */
static void inner_folder(char *path)
{
    Dl_info own;
    path[0] = '\0';
    if ((dladdr((const void *)&inner_close, &own) != 0) && (own.dli_fname != 0))
    {
        char real[INNER_PATH];
        char *found = realpath(own.dli_fname, real);
        for (int up = 0; (found != 0) && (up < 3); up++) /* the file, its folder, binaries */
        {
            char *cut = strrchr(found, '/');
            found = (cut == 0) ? 0 : found;
            if (cut != 0)
            {
                *cut = '\0';
            }
        }
        if (found != 0)
        {
            (void)snprintf(path, INNER_PATH, "%s/resources/inner", found);
        }
    }
}

#if INNER_FMI == 3
static void inner_log(void *of, int status, const char *category, const char *message)
{
    (void)of, (void)status, (void)category, (void)message;
}
#else
static void inner_log(void *of, const char *name, int status, const char *category, const char *message, ...)
{
    (void)of, (void)name, (void)status, (void)category, (void)message;
}
typedef struct
{
    void (*log)(void *, const char *, int, const char *, const char *, ...);
    void *(*allocate)(size_t, size_t);
    void (*release)(void *);
    void (*done)(void *, int);
    void *of;
} inner_calls;
typedef struct
{
    int again, stop, nominals, values, defined;
    double next;
} inner_event;
#endif

#define INNER_FIND(type, name) ((type)dlsym(i->library, name))

/* A new instance, initialised with parameters and inputs; `x` becomes its states. 0 where that fails. */
static void *inner_open(const inner_about *a, double time, const double *p, const double *u, double *x)
{
    char folder[INNER_PATH], file[2 * INNER_PATH], resources[2 * INNER_PATH];
    inner *i = (inner *)calloc(1, sizeof *i);
    int bad = 1;
    if (i == 0)
    {
        return 0;
    }
    inner_folder(folder);
    (void)snprintf(file, sizeof file, "%s/%s", folder, a->library);
    i->library = dlopen(file, RTLD_NOW | RTLD_LOCAL);
    if (i->library != 0)
    {
#if INNER_FMI == 3
        (void)snprintf(resources, sizeof resources, "%s/resources/", folder);
        void *(*begin)(const char *, const char *, const char *, bool, bool, void *, void (*)(void *, int, const char *, const char *)) =
            INNER_FIND(void *(*)(const char *, const char *, const char *, bool, bool, void *, void (*)(void *, int, const char *, const char *)), "fmi3InstantiateModelExchange");
        int (*enter)(void *, bool, double, double, bool, double) = INNER_FIND(int (*)(void *, bool, double, double, bool, double), "fmi3EnterInitializationMode");
        int (*leave)(void *) = INNER_FIND(int (*)(void *), "fmi3ExitInitializationMode");
        int (*update)(void *, bool *, bool *, bool *, bool *, bool *, double *) = INNER_FIND(int (*)(void *, bool *, bool *, bool *, bool *, bool *, double *), "fmi3UpdateDiscreteStates");
        int (*go)(void *) = INNER_FIND(int (*)(void *), "fmi3EnterContinuousTimeMode");
        i->end = INNER_FIND(void (*)(void *), "fmi3FreeInstance");
        i->set_time = INNER_FIND(int (*)(void *, double), "fmi3SetTime");
        i->set_states = INNER_FIND(int (*)(void *, const double *, size_t), "fmi3SetContinuousStates");
        i->get_states = INNER_FIND(int (*)(void *, double *, size_t), "fmi3GetContinuousStates");
        i->get_rates = INNER_FIND(int (*)(void *, double *, size_t), "fmi3GetContinuousStateDerivatives");
        i->set = INNER_FIND(int (*)(void *, const unsigned *, size_t, const double *, size_t), "fmi3SetFloat64");
        i->get = INNER_FIND(int (*)(void *, const unsigned *, size_t, double *, size_t), "fmi3GetFloat64");
        i->component = begin("inner", a->token, resources, false, false, 0, inner_log);
        bad = (i->component == 0) || (inner_set(i, a->parameter, a->parameters, a->parameter_scale, p) > INNER_FINE) ||
              (inner_set(i, a->input, a->inputs, a->input_scale, u) > INNER_FINE) ||
              (enter(i->component, false, 0.0, time, false, 0.0) > INNER_FINE) || (leave(i->component) > INNER_FINE);
        bool again = !bad;
        for (int round = 0; again && (round < INNER_ROUNDS); round++)
        {
            bool stop = false, nominals = false, values = false, defined = false;
            double next = 0.0;
            bad = (update(i->component, &again, &stop, &nominals, &values, &defined, &next) > INNER_FINE) || stop;
            again = again && !bad;
        }
#else
        static const inner_calls calls = {inner_log, calloc, free, 0, 0};
        (void)snprintf(resources, sizeof resources, "file://%s/resources", folder);
        void *(*begin)(const char *, int, const char *, const char *, const inner_calls *, int, int) =
            INNER_FIND(void *(*)(const char *, int, const char *, const char *, const inner_calls *, int, int), "fmi2Instantiate");
        int (*setup)(void *, int, double, double, int, double) = INNER_FIND(int (*)(void *, int, double, double, int, double), "fmi2SetupExperiment");
        int (*enter)(void *) = INNER_FIND(int (*)(void *), "fmi2EnterInitializationMode");
        int (*leave)(void *) = INNER_FIND(int (*)(void *), "fmi2ExitInitializationMode");
        int (*update)(void *, inner_event *) = INNER_FIND(int (*)(void *, inner_event *), "fmi2NewDiscreteStates");
        int (*go)(void *) = INNER_FIND(int (*)(void *), "fmi2EnterContinuousTimeMode");
        i->end = INNER_FIND(void (*)(void *), "fmi2FreeInstance");
        i->set_time = INNER_FIND(int (*)(void *, double), "fmi2SetTime");
        i->set_states = INNER_FIND(int (*)(void *, const double *, size_t), "fmi2SetContinuousStates");
        i->get_states = INNER_FIND(int (*)(void *, double *, size_t), "fmi2GetContinuousStates");
        i->get_rates = INNER_FIND(int (*)(void *, double *, size_t), "fmi2GetDerivatives");
        i->set = INNER_FIND(int (*)(void *, const unsigned *, size_t, const double *), "fmi2SetReal");
        i->get = INNER_FIND(int (*)(void *, const unsigned *, size_t, double *), "fmi2GetReal");
        i->component = begin("inner", 0, a->token, resources, &calls, 0, 0);
        bad = (i->component == 0) || (inner_set(i, a->parameter, a->parameters, a->parameter_scale, p) > INNER_FINE) ||
              (inner_set(i, a->input, a->inputs, a->input_scale, u) > INNER_FINE) ||
              (setup(i->component, 0, 0.0, time, 0, 0.0) > INNER_FINE) || (enter(i->component) > INNER_FINE) ||
              (leave(i->component) > INNER_FINE);
        inner_event event = {!bad, 0, 0, 0, 0, 0.0};
        for (int round = 0; (event.again != 0) && (round < INNER_ROUNDS); round++)
        {
            bad = (update(i->component, &event) > INNER_FINE) || (event.stop != 0);
            event.again = bad ? 0 : event.again;
        }
#endif
        bad = bad || (go(i->component) > INNER_FINE) ||
              ((a->states > 0) && (i->get_states(i->component, i->own, (size_t)a->states) > INNER_FINE));
    }
    for (int j = 0; (bad == 0) && (j < a->states); j++)
    {
        x[j] = (a->state_scale[j][0] * i->own[j]) + a->state_scale[j][1];
    }
    if (bad != 0)
    {
        inner_close(i);
        i = 0;
    }
    return i;
}

#endif
