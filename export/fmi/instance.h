/* An instance of an FMU for co-simulation, whatever the version of FMI: the model, its time, and what may be set when. */
#ifndef INSTANCE_H
#define INSTANCE_H

#include "model.h"
#include <math.h>
#include <stdlib.h>
#include <string.h>

#if defined(_WIN32)
#define EXPORTED __declspec(dllexport)
#else
#define EXPORTED __attribute__((visibility("default")))
#endif

enum { OK = 0, DISCARD = 2, ERROR = 3 }; /* the statuses of FMI 2 and 3 that are used here */
enum { STARTING, RUNNING, ENDED };

typedef struct
{
    model now;
    double time;
    int phase;
} instance;

static instance *instance_new(const char *token)
{
    instance *made = 0;
    if ((token != 0) && (strcmp(token, MODEL_TOKEN) == 0))
    {
        made = (instance *)calloc(1, sizeof(instance));
    }
    if (made != 0)
    {
        model_start(&made->now);
    }
    return made;
}

static void instance_free(instance *i)
{
    if (i != 0)
    {
        model_end(&i->now);
        free(i);
    }
}

static int instance_reset(instance *i)
{
    model_end(&i->now);
    (void)memset(i, 0, sizeof *i);
    model_start(&i->now);
    return OK;
}

static int instance_begin(instance *i, double time)
{
    if (i->phase != STARTING)
    {
        return ERROR;
    }
    i->time = time;
    model_initialize(&i->now, time);
    return OK;
}

/* Parameters may have been set since `instance_begin`. */
static int instance_run(instance *i)
{
    if (i->phase != STARTING)
    {
        return ERROR;
    }
    model_initialize(&i->now, i->time);
    i->phase = RUNNING;
    return OK;
}

static int instance_get(instance *i, const unsigned *reference, size_t count, double *value)
{
    model_outputs(&i->now);
    for (size_t k = 0; k < count; k++)
    {
        if (reference[k] > (unsigned)MODEL_VALUES)
        {
            return ERROR;
        }
        value[k] = (reference[k] == 0u) ? i->time : i->now.value[reference[k] - 1u];
    }
    return OK;
}

/* Inputs may be set at any time, parameters before the first step; nothing that is not finite. */
static int instance_set(instance *i, const unsigned *reference, size_t count, const double *value)
{
    for (size_t k = 0; k < count; k++)
    {
        const unsigned at = reference[k] - 1u; /* 0, the time, becomes the largest number */
        if ((at >= (unsigned)(MODEL_INPUTS + MODEL_PARAMETERS)) || !isfinite(value[k]) ||
            ((at >= (unsigned)MODEL_INPUTS) && (i->phase != STARTING)))
        {
            return ERROR;
        }
    }
    for (size_t k = 0; k < count; k++)
    {
        i->now.value[reference[k] - 1u] = value[k];
    }
    return OK;
}

static int instance_step(instance *i, double from, double size)
{
    if ((i->phase != RUNNING) || !(size >= 0.0) || !(fabs(from - i->time) <= 1e-9 * fmax(fabs(from), MODEL_PERIOD)))
    {
        return ERROR;
    }
    if (model_advance(&i->now, from, from + size) != 0)
    {
        i->phase = ENDED;
        return ERROR;
    }
    i->time = from + size;
    return OK;
}

static int instance_keep(const instance *i, void **kept)
{
    if ((*kept == 0) && (MODEL_COPIES != 0))
    {
        *kept = malloc(sizeof *i);
    }
    if (*kept == 0)
    {
        return ERROR;
    }
    (void)memcpy(*kept, i, sizeof *i);
    return OK;
}

static int instance_return(instance *i, const void *kept)
{
    if (kept == 0)
    {
        return ERROR;
    }
    (void)memcpy(i, kept, sizeof *i);
    return OK;
}

static int instance_forget(void **kept)
{
    free(*kept);
    *kept = 0;
    return OK;
}

static int instance_write(const void *kept, unsigned char *bytes, size_t size)
{
    if ((kept == 0) || (size < sizeof(instance)))
    {
        return ERROR;
    }
    (void)memcpy(bytes, kept, sizeof(instance));
    return OK;
}

static int instance_read(const unsigned char *bytes, size_t size, void **kept)
{
    if ((size != sizeof(instance)) || (MODEL_COPIES == 0))
    {
        return ERROR;
    }
    *kept = malloc(size);
    if (*kept == 0)
    {
        return ERROR;
    }
    (void)memcpy(*kept, bytes, size);
    return OK;
}

#endif
