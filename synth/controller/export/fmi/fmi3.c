/* All functions of FMI 3.0. What is not supported returns fmi3Error and logs one line. */
#include <stdlib.h>
#include <string.h>
#include "fmu.h"

#if defined(FMU_STANDARD_HEADERS)
#define FMI3_OVERRIDE_FUNCTION_PREFIX
#include "fmi3Functions.h" /* to compare the declarations with the standard's */
#else
#include <stdbool.h>
#include <stdint.h>
/* The types of the standard, as far as they are needed. */
typedef void *fmi3Instance;
typedef void *fmi3InstanceEnvironment;
typedef void *fmi3FMUState;
typedef uint32_t fmi3ValueReference;
typedef float fmi3Float32;
typedef double fmi3Float64;
typedef int8_t fmi3Int8;
typedef uint8_t fmi3UInt8;
typedef int16_t fmi3Int16;
typedef uint16_t fmi3UInt16;
typedef int32_t fmi3Int32;
typedef uint32_t fmi3UInt32;
typedef int64_t fmi3Int64;
typedef uint64_t fmi3UInt64;
typedef bool fmi3Boolean;
typedef const char *fmi3String;
typedef uint8_t fmi3Byte;
typedef const fmi3Byte *fmi3Binary;
typedef bool fmi3Clock;
typedef enum { fmi3OK, fmi3Warning, fmi3Discard, fmi3Error, fmi3Fatal } fmi3Status;
typedef enum { fmi3Independent, fmi3Constant, fmi3Fixed, fmi3Tunable, fmi3Discrete, fmi3Dependent } fmi3DependencyKind;
typedef enum { fmi3IntervalNotYetKnown, fmi3IntervalUnchanged, fmi3IntervalChanged } fmi3IntervalQualifier;
typedef void (*fmi3LogMessageCallback)(fmi3InstanceEnvironment, fmi3Status, fmi3String, fmi3String);
typedef void (*fmi3ClockUpdateCallback)(fmi3InstanceEnvironment);
typedef void (*fmi3IntermediateUpdateCallback)(fmi3InstanceEnvironment, fmi3Float64, fmi3Boolean, fmi3Boolean, fmi3Boolean,
                                               fmi3Boolean, fmi3Boolean *, fmi3Float64 *);
typedef void (*fmi3LockPreemptionCallback)(void);
typedef void (*fmi3UnlockPreemptionCallback)(void);
#endif

enum { CO_SIMULATION, MODEL_EXCHANGE };

typedef struct
{
    fmu_core core;
    fmi3InstanceEnvironment environment;
    fmi3LogMessageCallback log;
    int kind;
} instance;

/* Logs what went wrong, and returns the status. */
static fmi3Status answer(instance *one, int status)
{
    if ((status != FMU_OK) && (one->log != NULL))
    {
        one->log(one->environment, (fmi3Status)status, fmu_category(status), one->core.said);
    }
    return (fmi3Status)status;
}

static fmi3Status refuse(fmi3Instance c, const char *why)
{
    instance *one = (instance *)c;

    return (one == NULL) ? fmi3Error : answer(one, fmu_refuse(&one->core, FMU_ERROR, why));
}

static int is_of(fmi3Instance c, int kind)
{
    const instance *one = (const instance *)c;

    return (one != NULL) && (one->kind == kind);
}

static const char OTHER[] = "this function is of the other kind of FMI: co-simulation or model exchange";
static const char REALS[] = "all variables are Float64; there are none of another type";
static const char CLOCKS[] = "there are no clocks";

static fmi3Instance begun(int kind, fmi3String name, fmi3String token, fmi3InstanceEnvironment environment,
                          fmi3LogMessageCallback log)
{
    const char *why = NULL;
    instance *one = NULL;

    if ((token == NULL) || (strcmp(token, FMU_TOKEN) != 0))
    {
        why = "the instantiation token is not the one of modelDescription.xml";
    }
    else if ((kind == MODEL_EXCHANGE) && (FMU_STATES == 0))
    {
        why = "this FMU is for co-simulation alone";
    }
    else
    {
        one = (instance *)calloc(1, sizeof *one);
        why = (one == NULL) ? "there is no memory for an instance" : NULL;
    }
    if ((why != NULL) && (log != NULL))
    {
        log(environment, fmi3Error, "logStatusError", why);
    }
    if (one != NULL)
    {
        one->environment = environment;
        one->log = log;
        one->kind = kind;
        fmu_begin(&one->core, name);
    }
    return one;
}

FMU_PUBLIC const char *fmi3GetVersion(void)
{
    return "3.0";
}

FMU_PUBLIC fmi3Status fmi3SetDebugLogging(fmi3Instance c, fmi3Boolean on, size_t count, const fmi3String categories[])
{
    (void)on;
    (void)count;
    (void)categories;
    return (c == NULL) ? fmi3Error : fmi3OK;
}

FMU_PUBLIC fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources,
                                                     fmi3Boolean visible, fmi3Boolean logging,
                                                     fmi3InstanceEnvironment environment, fmi3LogMessageCallback log)
{
    (void)resources;
    (void)visible;
    (void)logging;
    return begun(MODEL_EXCHANGE, name, token, environment, log);
}

FMU_PUBLIC fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources,
                                                    fmi3Boolean visible, fmi3Boolean logging, fmi3Boolean event_mode,
                                                    fmi3Boolean early_return, const fmi3ValueReference intermediate[],
                                                    size_t count, fmi3InstanceEnvironment environment,
                                                    fmi3LogMessageCallback log, fmi3IntermediateUpdateCallback update)
{
    (void)resources;
    (void)visible;
    (void)logging;
    (void)event_mode;
    (void)early_return;
    (void)intermediate;
    (void)count;
    (void)update;
    return begun(CO_SIMULATION, name, token, environment, log);
}

FMU_PUBLIC fmi3Instance fmi3InstantiateScheduledExecution(fmi3String name, fmi3String token, fmi3String resources,
                                                          fmi3Boolean visible, fmi3Boolean logging,
                                                          fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                                          fmi3ClockUpdateCallback update, fmi3LockPreemptionCallback lock,
                                                          fmi3UnlockPreemptionCallback unlock)
{
    (void)name;
    (void)token;
    (void)resources;
    (void)visible;
    (void)logging;
    (void)update;
    (void)lock;
    (void)unlock;
    if (log != NULL)
    {
        log(environment, fmi3Error, "logStatusError", "scheduled execution is not supported");
    }
    return NULL;
}

FMU_PUBLIC void fmi3FreeInstance(fmi3Instance c)
{
    free(c);
}

FMU_PUBLIC fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean with_tolerance, fmi3Float64 tolerance,
                                                  fmi3Float64 start, fmi3Boolean with_stop, fmi3Float64 stop)
{
    instance *one = (instance *)c;

    (void)with_tolerance;
    (void)tolerance;
    (void)with_stop;
    (void)stop;
    if (one == NULL)
    {
        return fmi3Error;
    }
    one->core.now.time = start;
    return answer(one, fmu_initialize(&one->core, 1));
}

FMU_PUBLIC fmi3Status fmi3ExitInitializationMode(fmi3Instance c)
{
    instance *one = (instance *)c;

    return (one == NULL) ? fmi3Error : answer(one, fmu_initialize(&one->core, 0));
}

FMU_PUBLIC fmi3Status fmi3EnterEventMode(fmi3Instance c)
{
    return is_of(c, MODEL_EXCHANGE) ? fmi3OK : refuse(c, OTHER);
}

FMU_PUBLIC fmi3Status fmi3Terminate(fmi3Instance c)
{
    instance *one = (instance *)c;

    if (one == NULL)
    {
        return fmi3Error;
    }
    one->core.now.mode = FMU_ENDED;
    return fmi3OK;
}

FMU_PUBLIC fmi3Status fmi3Reset(fmi3Instance c)
{
    instance *one = (instance *)c;

    if (one == NULL)
    {
        return fmi3Error;
    }
    fmu_begin(&one->core, NULL);
    return fmi3OK;
}

FMU_PUBLIC fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t count, fmi3Float64 values[],
                                     size_t room)
{
    instance *one = (instance *)c;

    if (count != room)
    {
        return refuse(c, "every variable is one number");
    }
    return (one == NULL) ? fmi3Error : answer(one, fmu_get(&one->core, vr, count, values));
}

FMU_PUBLIC fmi3Status fmi3SetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t count, const fmi3Float64 values[],
                                     size_t room)
{
    instance *one = (instance *)c;

    if (count != room)
    {
        return refuse(c, "every variable is one number");
    }
    return (one == NULL) ? fmi3Error : answer(one, fmu_set(&one->core, vr, count, values));
}

#define NONE_OF(function, type)                                                                                          \
    FMU_PUBLIC fmi3Status function(fmi3Instance c, const fmi3ValueReference vr[], size_t count, type values[],           \
                                   size_t room)                                                                          \
    {                                                                                                                    \
        (void)vr;                                                                                                        \
        (void)values;                                                                                                    \
        return ((c != NULL) && (count == 0U) && (room == 0U)) ? fmi3OK : refuse(c, REALS);                               \
    }
#define NONE_OF_SIZE(function, sizes, type)                                                                              \
    FMU_PUBLIC fmi3Status function(fmi3Instance c, const fmi3ValueReference vr[], size_t count, sizes lengths[],         \
                                   type values[], size_t room)                                                           \
    {                                                                                                                    \
        (void)vr;                                                                                                        \
        (void)lengths;                                                                                                   \
        (void)values;                                                                                                    \
        return ((c != NULL) && (count == 0U) && (room == 0U)) ? fmi3OK : refuse(c, REALS);                               \
    }
#define NO_CLOCK(function, type)                                                                                         \
    FMU_PUBLIC fmi3Status function(fmi3Instance c, const fmi3ValueReference vr[], size_t count, type values[])           \
    {                                                                                                                    \
        (void)vr;                                                                                                        \
        (void)values;                                                                                                    \
        return ((c != NULL) && (count == 0U)) ? fmi3OK : refuse(c, CLOCKS);                                              \
    }
#define NO_FRACTION(function, type)                                                                                      \
    FMU_PUBLIC fmi3Status function(fmi3Instance c, const fmi3ValueReference vr[], size_t count, type counters[],         \
                                   type resolutions[])                                                                   \
    {                                                                                                                    \
        (void)vr;                                                                                                        \
        (void)counters;                                                                                                  \
        (void)resolutions;                                                                                               \
        return ((c != NULL) && (count == 0U)) ? fmi3OK : refuse(c, CLOCKS);                                              \
    }

NONE_OF(fmi3GetFloat32, fmi3Float32)
NONE_OF(fmi3GetInt8, fmi3Int8)
NONE_OF(fmi3GetUInt8, fmi3UInt8)
NONE_OF(fmi3GetInt16, fmi3Int16)
NONE_OF(fmi3GetUInt16, fmi3UInt16)
NONE_OF(fmi3GetInt32, fmi3Int32)
NONE_OF(fmi3GetUInt32, fmi3UInt32)
NONE_OF(fmi3GetInt64, fmi3Int64)
NONE_OF(fmi3GetUInt64, fmi3UInt64)
NONE_OF(fmi3GetBoolean, fmi3Boolean)
NONE_OF(fmi3GetString, fmi3String)
NONE_OF_SIZE(fmi3GetBinary, size_t, fmi3Binary)
NO_CLOCK(fmi3GetClock, fmi3Clock)
NONE_OF(fmi3SetFloat32, const fmi3Float32)
NONE_OF(fmi3SetInt8, const fmi3Int8)
NONE_OF(fmi3SetUInt8, const fmi3UInt8)
NONE_OF(fmi3SetInt16, const fmi3Int16)
NONE_OF(fmi3SetUInt16, const fmi3UInt16)
NONE_OF(fmi3SetInt32, const fmi3Int32)
NONE_OF(fmi3SetUInt32, const fmi3UInt32)
NONE_OF(fmi3SetInt64, const fmi3Int64)
NONE_OF(fmi3SetUInt64, const fmi3UInt64)
NONE_OF(fmi3SetBoolean, const fmi3Boolean)
NONE_OF(fmi3SetString, const fmi3String)
NONE_OF_SIZE(fmi3SetBinary, const size_t, const fmi3Binary)
NO_CLOCK(fmi3SetClock, const fmi3Clock)

NO_CLOCK(fmi3GetShiftDecimal, fmi3Float64)
NO_FRACTION(fmi3GetShiftFraction, fmi3UInt64)
NO_CLOCK(fmi3SetIntervalDecimal, const fmi3Float64)
NO_FRACTION(fmi3SetIntervalFraction, const fmi3UInt64)
NO_CLOCK(fmi3SetShiftDecimal, const fmi3Float64)
NO_FRACTION(fmi3SetShiftFraction, const fmi3UInt64)

FMU_PUBLIC fmi3Status fmi3GetIntervalDecimal(fmi3Instance c, const fmi3ValueReference vr[], size_t count,
                                             fmi3Float64 intervals[], fmi3IntervalQualifier qualifiers[])
{
    (void)vr;
    (void)intervals;
    (void)qualifiers;
    return ((c != NULL) && (count == 0U)) ? fmi3OK : refuse(c, CLOCKS);
}

FMU_PUBLIC fmi3Status fmi3GetIntervalFraction(fmi3Instance c, const fmi3ValueReference vr[], size_t count,
                                              fmi3UInt64 counters[], fmi3UInt64 resolutions[],
                                              fmi3IntervalQualifier qualifiers[])
{
    (void)vr;
    (void)counters;
    (void)resolutions;
    (void)qualifiers;
    return ((c != NULL) && (count == 0U)) ? fmi3OK : refuse(c, CLOCKS);
}

FMU_PUBLIC fmi3Status fmi3GetNumberOfVariableDependencies(fmi3Instance c, fmi3ValueReference vr, size_t *count)
{
    (void)vr;
    (void)count;
    return refuse(c, "dependencies stand in modelDescription.xml");
}

FMU_PUBLIC fmi3Status fmi3GetVariableDependencies(fmi3Instance c, fmi3ValueReference dependent, size_t of_dependent[],
                                                  fmi3ValueReference independents[], size_t of_independents[],
                                                  fmi3DependencyKind kinds[], size_t count)
{
    (void)dependent;
    (void)of_dependent;
    (void)independents;
    (void)of_independents;
    (void)kinds;
    (void)count;
    return refuse(c, "dependencies stand in modelDescription.xml");
}

FMU_PUBLIC fmi3Status fmi3GetFMUState(fmi3Instance c, fmi3FMUState *state)
{
    instance *one = (instance *)c;

    return (one == NULL) ? fmi3Error : answer(one, fmu_keep(&one->core, state));
}

FMU_PUBLIC fmi3Status fmi3SetFMUState(fmi3Instance c, fmi3FMUState state)
{
    instance *one = (instance *)c;

    return (one == NULL) ? fmi3Error : answer(one, fmu_restore(&one->core, state));
}

FMU_PUBLIC fmi3Status fmi3FreeFMUState(fmi3Instance c, fmi3FMUState *state)
{
    instance *one = (instance *)c;

    return (one == NULL) ? fmi3Error : answer(one, fmu_free_kept(&one->core, state));
}

FMU_PUBLIC fmi3Status fmi3SerializedFMUStateSize(fmi3Instance c, fmi3FMUState state, size_t *size)
{
    (void)state;
    *size = sizeof(fmu_content);
    return (c == NULL) ? fmi3Error : fmi3OK;
}

FMU_PUBLIC fmi3Status fmi3SerializeFMUState(fmi3Instance c, fmi3FMUState state, fmi3Byte bytes[], size_t size)
{
    instance *one = (instance *)c;

    return (one == NULL) ? fmi3Error : answer(one, fmu_serialize(&one->core, state, bytes, size));
}

FMU_PUBLIC fmi3Status fmi3DeserializeFMUState(fmi3Instance c, const fmi3Byte bytes[], size_t size, fmi3FMUState *state)
{
    instance *one = (instance *)c;

    return (one == NULL) ? fmi3Error : answer(one, fmu_deserialize(&one->core, bytes, size, state));
}

FMU_PUBLIC fmi3Status fmi3GetDirectionalDerivative(fmi3Instance c, const fmi3ValueReference unknowns[], size_t rows,
                                                   const fmi3ValueReference knowns[], size_t columns,
                                                   const fmi3Float64 seed[], size_t seeds, fmi3Float64 sensitivity[],
                                                   size_t sensitivities)
{
    instance *one = (instance *)c;

    if ((seeds != columns) || (sensitivities != rows))
    {
        return refuse(c, "every variable is one number");
    }
    return (one == NULL) ? fmi3Error
                         : answer(one, fmu_slopes(&one->core, unknowns, rows, knowns, columns, seed, sensitivity));
}

FMU_PUBLIC fmi3Status fmi3GetAdjointDerivative(fmi3Instance c, const fmi3ValueReference unknowns[], size_t rows,
                                               const fmi3ValueReference knowns[], size_t columns, const fmi3Float64 seed[],
                                               size_t seeds, fmi3Float64 sensitivity[], size_t sensitivities)
{
    (void)unknowns;
    (void)rows;
    (void)knowns;
    (void)columns;
    (void)seed;
    (void)seeds;
    (void)sensitivity;
    (void)sensitivities;
    return refuse(c, "adjoint derivatives are not supported; take directional ones");
}

FMU_PUBLIC fmi3Status fmi3EnterConfigurationMode(fmi3Instance c)
{
    return refuse(c, "there are no structural parameters");
}

FMU_PUBLIC fmi3Status fmi3ExitConfigurationMode(fmi3Instance c)
{
    return refuse(c, "there are no structural parameters");
}

FMU_PUBLIC fmi3Status fmi3EvaluateDiscreteStates(fmi3Instance c)
{
    return is_of(c, MODEL_EXCHANGE) ? fmi3OK : refuse(c, OTHER);
}

FMU_PUBLIC fmi3Status fmi3UpdateDiscreteStates(fmi3Instance c, fmi3Boolean *again, fmi3Boolean *terminate,
                                               fmi3Boolean *nominals, fmi3Boolean *values, fmi3Boolean *defined,
                                               fmi3Float64 *next)
{
    *again = false;
    *terminate = false;
    *nominals = false;
    *values = false;
    *defined = false;
    *next = 0.0;
    return is_of(c, MODEL_EXCHANGE) ? fmi3OK : refuse(c, OTHER);
}

/* Model exchange. */

FMU_PUBLIC fmi3Status fmi3EnterContinuousTimeMode(fmi3Instance c)
{
    return is_of(c, MODEL_EXCHANGE) ? fmi3OK : refuse(c, OTHER);
}

FMU_PUBLIC fmi3Status fmi3CompletedIntegratorStep(fmi3Instance c, fmi3Boolean no_set, fmi3Boolean *enter_event_mode,
                                                  fmi3Boolean *terminate)
{
    (void)no_set;
    *enter_event_mode = false;
    *terminate = false;
    return is_of(c, MODEL_EXCHANGE) ? fmi3OK : refuse(c, OTHER);
}

FMU_PUBLIC fmi3Status fmi3SetTime(fmi3Instance c, fmi3Float64 time)
{
    if (!is_of(c, MODEL_EXCHANGE))
    {
        return refuse(c, OTHER);
    }
    ((instance *)c)->core.now.time = time;
    return fmi3OK;
}

FMU_PUBLIC fmi3Status fmi3SetContinuousStates(fmi3Instance c, const fmi3Float64 x[], size_t count)
{
    instance *one = (instance *)c;

    return is_of(c, MODEL_EXCHANGE) ? answer(one, fmu_set_states(&one->core, x, count)) : refuse(c, OTHER);
}

FMU_PUBLIC fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance c, fmi3Float64 derivatives[], size_t count)
{
    instance *one = (instance *)c;

    return is_of(c, MODEL_EXCHANGE) ? answer(one, fmu_states(&one->core, 1, derivatives, count)) : refuse(c, OTHER);
}

FMU_PUBLIC fmi3Status fmi3GetEventIndicators(fmi3Instance c, fmi3Float64 indicators[], size_t count)
{
    (void)indicators;
    return (is_of(c, MODEL_EXCHANGE) && (count == 0U)) ? fmi3OK : refuse(c, "there are no event indicators");
}

FMU_PUBLIC fmi3Status fmi3GetContinuousStates(fmi3Instance c, fmi3Float64 x[], size_t count)
{
    instance *one = (instance *)c;

    return is_of(c, MODEL_EXCHANGE) ? answer(one, fmu_states(&one->core, 0, x, count)) : refuse(c, OTHER);
}

FMU_PUBLIC fmi3Status fmi3GetNominalsOfContinuousStates(fmi3Instance c, fmi3Float64 nominals[], size_t count)
{
    size_t i;

    for (i = 0; i < count; i++)
    {
        nominals[i] = 1.0;
    }
    return is_of(c, MODEL_EXCHANGE) ? fmi3OK : refuse(c, OTHER);
}

FMU_PUBLIC fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance c, size_t *count)
{
    *count = 0U;
    return is_of(c, MODEL_EXCHANGE) ? fmi3OK : refuse(c, OTHER);
}

FMU_PUBLIC fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance c, size_t *count)
{
    *count = (size_t)FMU_STATES;
    return is_of(c, MODEL_EXCHANGE) ? fmi3OK : refuse(c, OTHER);
}

/* Co-simulation. */

FMU_PUBLIC fmi3Status fmi3EnterStepMode(fmi3Instance c)
{
    return refuse(c, "there is no event mode in this co-simulation");
}

FMU_PUBLIC fmi3Status fmi3GetOutputDerivatives(fmi3Instance c, const fmi3ValueReference vr[], size_t count,
                                               const fmi3Int32 orders[], fmi3Float64 values[], size_t room)
{
    (void)vr;
    (void)count;
    (void)orders;
    (void)values;
    (void)room;
    return refuse(c, "derivatives of outputs are not supported");
}

FMU_PUBLIC fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 time, fmi3Float64 step, fmi3Boolean no_set,
                                 fmi3Boolean *event_needed, fmi3Boolean *terminate, fmi3Boolean *early,
                                 fmi3Float64 *last_time)
{
    instance *one = (instance *)c;
    fmi3Status status;

    (void)no_set;
    *event_needed = false;
    *terminate = false;
    *early = false;
    if (!is_of(c, CO_SIMULATION))
    {
        return refuse(c, OTHER);
    }
    status = answer(one, fmu_advance(&one->core, time, step));
    *last_time = one->core.now.time;
    return status;
}

/* Scheduled execution. */

FMU_PUBLIC fmi3Status fmi3ActivateModelPartition(fmi3Instance c, fmi3ValueReference clock, fmi3Float64 time)
{
    (void)clock;
    (void)time;
    return refuse(c, "scheduled execution is not supported");
}
