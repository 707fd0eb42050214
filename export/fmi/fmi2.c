/* The functions of FMI 2.0 for co-simulation, written to its standard; what a model of doubles has not is an error. */
#include "instance.h"

typedef struct
{
    void (*logger)(void *environment, const char *name, int status, const char *category, const char *message, ...);
    void *(*allocate)(size_t count, size_t size);
    void (*release)(void *memory);
    void (*finished)(void *environment, int status);
    void *environment;
} callbacks;

EXPORTED const char *fmi2GetTypesPlatform(void) { return "default"; }
EXPORTED const char *fmi2GetVersion(void) { return "2.0"; }

EXPORTED int fmi2SetDebugLogging(void *i, int on, size_t count, const char *const categories[])
{
    (void)i, (void)on, (void)count, (void)categories;
    return OK;
}

EXPORTED void *fmi2Instantiate(const char *name, int type, const char *token, const char *resources,
                               const callbacks *functions, int visible, int logging)
{
    (void)name, (void)resources, (void)functions, (void)visible, (void)logging;
    return (type == 1) ? instance_new(token) : 0; /* 1: co-simulation */
}

EXPORTED void fmi2FreeInstance(void *i) { instance_free((instance *)i); }

EXPORTED int fmi2SetupExperiment(void *i, int tolerance, double relative, double start, int stops, double stop)
{
    (void)tolerance, (void)relative, (void)stops, (void)stop;
    return instance_begin((instance *)i, start);
}

EXPORTED int fmi2EnterInitializationMode(void *i) { return (((instance *)i)->phase == STARTING) ? OK : ERROR; }
EXPORTED int fmi2ExitInitializationMode(void *i) { return instance_run((instance *)i); }
EXPORTED int fmi2Reset(void *i) { return instance_reset((instance *)i); }

EXPORTED int fmi2Terminate(void *i)
{
    ((instance *)i)->phase = ENDED;
    return OK;
}

EXPORTED int fmi2GetReal(void *i, const unsigned vr[], size_t count, double value[])
{
    return instance_get((instance *)i, vr, count, value);
}

EXPORTED int fmi2SetReal(void *i, const unsigned vr[], size_t count, const double value[])
{
    return instance_set((instance *)i, vr, count, value);
}

#define NO_SUCH(name, get, set)                                                  \
    EXPORTED int fmi2Get##name(void *i, const unsigned vr[], size_t count, get)  \
    {                                                                            \
        (void)i, (void)vr, (void)value;                                          \
        return (count == 0u) ? OK : ERROR;                                       \
    }                                                                            \
    EXPORTED int fmi2Set##name(void *i, const unsigned vr[], size_t count, set)  \
    {                                                                            \
        (void)i, (void)vr, (void)value;                                          \
        return (count == 0u) ? OK : ERROR;                                       \
    }
NO_SUCH(Integer, int value[], const int value[])
NO_SUCH(Boolean, int value[], const int value[])
NO_SUCH(String, const char *value[], const char *const value[])

EXPORTED int fmi2GetFMUstate(void *i, void **kept) { return instance_keep((instance *)i, kept); }
EXPORTED int fmi2SetFMUstate(void *i, void *kept) { return instance_return((instance *)i, kept); }

EXPORTED int fmi2FreeFMUstate(void *i, void **kept)
{
    (void)i;
    return instance_forget(kept);
}

EXPORTED int fmi2SerializedFMUstateSize(void *i, void *kept, size_t *size)
{
    (void)i, (void)kept;
    *size = sizeof(instance);
    return OK;
}

EXPORTED int fmi2SerializeFMUstate(void *i, void *kept, char bytes[], size_t size)
{
    (void)i;
    return instance_write(kept, (unsigned char *)bytes, size);
}

EXPORTED int fmi2DeSerializeFMUstate(void *i, const char bytes[], size_t size, void **kept)
{
    (void)i;
    return instance_read((const unsigned char *)bytes, size, kept);
}

EXPORTED int fmi2GetDirectionalDerivative(void *i, const unsigned of[], size_t ofs, const unsigned by[], size_t bys,
                                          const double seed[], double value[])
{
    (void)i, (void)of, (void)ofs, (void)by, (void)bys, (void)seed, (void)value;
    return ERROR;
}

EXPORTED int fmi2SetRealInputDerivatives(void *i, const unsigned vr[], size_t count, const int order[],
                                         const double value[])
{
    (void)i, (void)vr, (void)count, (void)order, (void)value;
    return ERROR;
}

EXPORTED int fmi2GetRealOutputDerivatives(void *i, const unsigned vr[], size_t count, const int order[], double value[])
{
    (void)i, (void)vr, (void)count, (void)order, (void)value;
    return ERROR;
}

EXPORTED int fmi2DoStep(void *i, double time, double size, int final)
{
    (void)final;
    return instance_step((instance *)i, time, size);
}

EXPORTED int fmi2CancelStep(void *i)
{
    (void)i;
    return ERROR;
}

#define NO_STATUS(name, type)                                     \
    EXPORTED int fmi2Get##name##Status(void *i, int kind, type *value) \
    {                                                             \
        (void)i, (void)kind, (void)value;                         \
        return DISCARD;                                           \
    }
EXPORTED int fmi2GetStatus(void *i, int kind, int *value)
{
    (void)i, (void)kind, (void)value;
    return DISCARD;
}
NO_STATUS(Real, double)
NO_STATUS(Integer, int)
NO_STATUS(Boolean, int)
NO_STATUS(String, const char *)
