/* The functions of FMI 3.0 for co-simulation, written to its standard; what a model of doubles has not is an error. */
#include "instance.h"
#include <stdbool.h>
#include <stdint.h>

EXPORTED const char *fmi3GetVersion(void) { return "3.0"; }

EXPORTED int fmi3SetDebugLogging(void *i, bool on, size_t count, const char *const categories[])
{
    (void)i, (void)on, (void)count, (void)categories;
    return OK;
}

EXPORTED void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *resources, bool visible,
                                           bool logging, bool events, bool early, const unsigned needed[],
                                           size_t count, void *environment, void (*log)(void), void (*update)(void))
{
    (void)name, (void)resources, (void)visible, (void)logging, (void)events, (void)early, (void)needed, (void)count;
    (void)environment, (void)log, (void)update;
    return instance_new(token);
}

EXPORTED void *fmi3InstantiateModelExchange(const char *name, const char *token, const char *resources, bool visible,
                                            bool logging, void *environment, void (*log)(void))
{
    (void)name, (void)token, (void)resources, (void)visible, (void)logging, (void)environment, (void)log;
    return 0;
}

EXPORTED void *fmi3InstantiateScheduledExecution(const char *name, const char *token, const char *resources,
                                                 bool visible, bool logging, void *environment, void (*log)(void),
                                                 void (*clock)(void), void (*lock)(void), void (*unlock)(void))
{
    (void)name, (void)token, (void)resources, (void)visible, (void)logging, (void)environment, (void)log;
    (void)clock, (void)lock, (void)unlock;
    return 0;
}

EXPORTED void fmi3FreeInstance(void *i) { instance_free((instance *)i); }

EXPORTED int fmi3EnterInitializationMode(void *i, bool tolerance, double relative, double start, bool stops, double stop)
{
    (void)tolerance, (void)relative, (void)stops, (void)stop;
    return instance_begin((instance *)i, start);
}

EXPORTED int fmi3ExitInitializationMode(void *i) { return instance_run((instance *)i); }
EXPORTED int fmi3EnterStepMode(void *i) { return (((instance *)i)->phase == RUNNING) ? OK : ERROR; }
EXPORTED int fmi3Reset(void *i) { return instance_reset((instance *)i); }

EXPORTED int fmi3Terminate(void *i)
{
    ((instance *)i)->phase = ENDED;
    return OK;
}

EXPORTED int fmi3GetFloat64(void *i, const unsigned vr[], size_t count, double value[], size_t values)
{
    return (values == count) ? instance_get((instance *)i, vr, count, value) : ERROR;
}

EXPORTED int fmi3SetFloat64(void *i, const unsigned vr[], size_t count, const double value[], size_t values)
{
    return (values == count) ? instance_set((instance *)i, vr, count, value) : ERROR;
}

#define NO_SUCH(name, type)                                                                                     \
    EXPORTED int fmi3Get##name(void *i, const unsigned vr[], size_t count, type value[], size_t values)         \
    {                                                                                                           \
        (void)i, (void)vr, (void)value, (void)values;                                                           \
        return (count == 0u) ? OK : ERROR;                                                                      \
    }                                                                                                           \
    EXPORTED int fmi3Set##name(void *i, const unsigned vr[], size_t count, const type value[], size_t values)   \
    {                                                                                                           \
        (void)i, (void)vr, (void)value, (void)values;                                                           \
        return (count == 0u) ? OK : ERROR;                                                                      \
    }
typedef const char *string;
NO_SUCH(Float32, float)
NO_SUCH(Int8, int8_t)
NO_SUCH(UInt8, uint8_t)
NO_SUCH(Int16, int16_t)
NO_SUCH(UInt16, uint16_t)
NO_SUCH(Int32, int32_t)
NO_SUCH(UInt32, uint32_t)
NO_SUCH(Int64, int64_t)
NO_SUCH(UInt64, uint64_t)
NO_SUCH(Boolean, bool)
NO_SUCH(String, string)

EXPORTED int fmi3GetBinary(void *i, const unsigned vr[], size_t count, size_t sizes[], const uint8_t *value[],
                           size_t values)
{
    (void)i, (void)vr, (void)sizes, (void)value, (void)values;
    return (count == 0u) ? OK : ERROR;
}

EXPORTED int fmi3SetBinary(void *i, const unsigned vr[], size_t count, const size_t sizes[],
                           const uint8_t *const value[], size_t values)
{
    (void)i, (void)vr, (void)sizes, (void)value, (void)values;
    return (count == 0u) ? OK : ERROR;
}

EXPORTED int fmi3GetFMUState(void *i, void **kept) { return instance_keep((instance *)i, kept); }
EXPORTED int fmi3SetFMUState(void *i, void *kept) { return instance_return((instance *)i, kept); }

EXPORTED int fmi3FreeFMUState(void *i, void **kept)
{
    (void)i;
    return instance_forget(kept);
}

EXPORTED int fmi3SerializedFMUStateSize(void *i, void *kept, size_t *size)
{
    (void)i, (void)kept;
    *size = sizeof(instance);
    return OK;
}

EXPORTED int fmi3SerializeFMUState(void *i, void *kept, uint8_t bytes[], size_t size)
{
    (void)i;
    return instance_write(kept, bytes, size);
}

EXPORTED int fmi3DeserializeFMUState(void *i, const uint8_t bytes[], size_t size, void **kept)
{
    (void)i;
    return instance_read(bytes, size, kept);
}

EXPORTED int fmi3DoStep(void *i, double time, double size, bool final, bool *event, bool *terminate, bool *early,
                        double *reached)
{
    const int status = instance_step((instance *)i, time, size);
    (void)final;
    *event = false;
    *terminate = false;
    *early = false;
    *reached = ((instance *)i)->time;
    return status;
}

/* What FMI 3.0 has for events, clocks, arrays and derivatives; no call may reach it by the model description. */
#define NEVER(name)                 \
    EXPORTED int fmi3##name(void *i) \
    {                               \
        (void)i;                    \
        return ERROR;               \
    }
NEVER(EnterEventMode)
NEVER(EnterConfigurationMode)
NEVER(ExitConfigurationMode)
NEVER(GetNumberOfVariableDependencies)
NEVER(GetVariableDependencies)
NEVER(GetDirectionalDerivative)
NEVER(GetAdjointDerivative)
NEVER(GetClock)
NEVER(SetClock)
NEVER(GetIntervalDecimal)
NEVER(GetIntervalFraction)
NEVER(GetShiftDecimal)
NEVER(GetShiftFraction)
NEVER(SetIntervalDecimal)
NEVER(SetIntervalFraction)
NEVER(SetShiftDecimal)
NEVER(SetShiftFraction)
NEVER(EvaluateDiscreteStates)
NEVER(UpdateDiscreteStates)
NEVER(EnterContinuousTimeMode)
NEVER(CompletedIntegratorStep)
NEVER(SetTime)
NEVER(SetContinuousStates)
NEVER(GetContinuousStateDerivatives)
NEVER(GetEventIndicators)
NEVER(GetContinuousStates)
NEVER(GetNominalsOfContinuousStates)
NEVER(GetNumberOfEventIndicators)
NEVER(GetNumberOfContinuousStates)
NEVER(GetOutputDerivatives)
NEVER(ActivateModelPartition)
