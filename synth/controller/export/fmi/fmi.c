/* All functions of FMI N.0. What is not supported returns fmiNError and logs one line. */
#include <math.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include "fmu.h"

#define FMI_VERSION N
#if defined(__GNUC__)
#pragma GCC diagnostic ignored "-Wunused-parameter" /* the standard's functions have more than an FMU needs */
#endif

/* The types of the standard, as far as they are needed. */
#if defined(FMU_STANDARD_HEADERS)
#define FMI3_OVERRIDE_FUNCTION_PREFIX
#include "fmiNFunctions.h" /* to compare the declarations with the standard's */
#else
typedef void *fmiNInstance;
typedef void *fmiNInstanceEnvironment;
typedef void *fmiNFMUState;
typedef uint32_t fmiNValueReference;
typedef double fmiNFloat64;
typedef const char *fmiNString;
#if FMI_VERSION == 2
typedef int fmi2Integer;
typedef int fmi2Boolean;
typedef char fmi2Byte;
typedef enum { fmi2OK, fmi2Warning, fmi2Discard, fmi2Error, fmi2Fatal, fmi2Pending } fmi2Status;
typedef enum { fmi2ModelExchange, fmi2CoSimulation } fmi2Type;
typedef enum { fmi2DoStepStatus, fmi2PendingStatus, fmi2LastSuccessfulTime, fmi2Terminated } fmi2StatusKind;
typedef struct
{
    void (*logger)(fmi2ComponentEnvironment, fmi2String, fmi2Status, fmi2String, fmi2String, ...);
    void *(*allocateMemory)(size_t, size_t);
    void (*freeMemory)(void *);
    void (*stepFinished)(fmi2ComponentEnvironment, fmi2Status);
    fmi2ComponentEnvironment componentEnvironment;
} fmi2CallbackFunctions;
typedef struct
{
    fmi2Boolean newDiscreteStatesNeeded;
    fmi2Boolean terminateSimulation;
    fmi2Boolean nominalsOfContinuousStatesChanged;
    fmi2Boolean valuesOfContinuousStatesChanged;
    fmi2Boolean nextEventTimeDefined;
    fmi2Real nextEventTime;
} fmi2EventInfo;
#else
typedef float fmi3Float32;
typedef int8_t fmi3Int8;
typedef uint8_t fmi3UInt8;
typedef int16_t fmi3Int16;
typedef uint16_t fmi3UInt16;
typedef int32_t fmi3Int32;
typedef uint32_t fmi3UInt32;
typedef int64_t fmi3Int64;
typedef uint64_t fmi3UInt64;
typedef bool fmi3Boolean;
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
#endif

/* FMI 3 gives the number of values beside the number of variables; here every variable is one number. */
#if FMI_VERSION == 2
#define ROOM
#define SEEDS
#define SENSITIVITIES
#define FITS(room, count) true
#define LOGGED(one) (one)->environment, (one)->name
typedef void (*fmi2LogMessageCallback)(fmi2ComponentEnvironment, fmi2String, fmi2Status, fmi2String, fmi2String, ...);
#else
#define ROOM , size_t room
#define SEEDS , size_t seeds
#define SENSITIVITIES , size_t sensitivities
#define FITS(room, count) ((room) == (count))
#define LOGGED(one) (one)->environment
#endif

#define NEAR 1e-6 /* relative: a step is as long as the sample period within this; masters count time in other units */

typedef enum { NEW, INITIALIZING, RUNNING, ENDED } fmu_mode;

/* What is copied as the state of an instance. */
typedef struct
{
    fmu_model model;
    fmu_mode mode;
} content;

typedef struct
{
    content now;
    bool exchange; /* for model exchange, not for co-simulation */
    char name[128];
    fmiNInstanceEnvironment environment;
    fmiNLogMessageCallback log;
} instance;

static const char OTHER[] = "this function is of the other kind of FMI: co-simulation or model exchange";
static const char NUMBERS[] = "every variable is one floating-point number; there are none of another type";

/* Logs a line, and returns the status. */
static fmiNStatus say(const instance *one, fmiNStatus status, const char *format, ...)
{
    static const char *const CATEGORIES[] = {"logStatusWarning", "logStatusWarning", "logStatusDiscard", "logStatusError"};
    char line[256];
    va_list values;

    va_start(values, format);
    (void)vsnprintf(line, sizeof line, format, values);
    va_end(values);
    if ((one != NULL) && (one->log != NULL))
    {
        one->log(LOGGED(one), status, CATEGORIES[status], line);
    }
    return status;
}

static fmiNStatus refuse(fmiNInstance c, const char *why)
{
    return say(c, fmiNError, "%s", why);
}

static bool exchanging(const void *c)
{
    return (c != NULL) && ((const instance *)c)->exchange;
}

/* Refuses a call of the instance c unless a condition holds. */
#define NEEDS(condition, why)                                                                                            \
    do                                                                                                                   \
    {                                                                                                                    \
        if (!(condition))                                                                                                \
        {                                                                                                                \
            return refuse(c, why);                                                                                       \
        }                                                                                                                \
    } while (0)

#define RETURNS(function, parameters, status)                                                                            \
    FMU_PUBLIC fmiNStatus function parameters                                                                            \
    {                                                                                                                    \
        return status;                                                                                                   \
    }

static void restart(instance *one)
{
    memset(&one->now, 0, sizeof one->now);
    one->now.mode = NEW;
    fmu_start(&one->now.model);
    fmu_update(&one->now.model);
}

/* Returns a new instance, or NULL. */
static instance *begun(const char *name, const char *token, bool exchange, fmiNInstanceEnvironment environment,
                       fmiNLogMessageCallback log)
{
    instance *one = (instance *)calloc(1U, sizeof *one);
    const char *why = NULL;

    if (one != NULL)
    {
        (void)snprintf(one->name, sizeof one->name, "%s", (name == NULL) ? "" : name);
        one->exchange = exchange;
        one->environment = environment;
        one->log = log;
        restart(one);
        if ((token == NULL) || (strcmp(token, FMU_TOKEN) != 0))
        {
            why = "the GUID or instantiation token is not that of modelDescription.xml";
        }
        else if (exchange && (FMU_STATES == 0))
        {
            why = "this FMU is for co-simulation alone";
        }
    }
    if (why != NULL)
    {
        (void)refuse(one, why);
        free(one);
        one = NULL;
    }
    return one;
}

static fmiNStatus initialize(instance *c, fmu_mode from, fmu_mode to)
{
    NEEDS((c != NULL) && (c->now.mode == from), "initialization begins after instantiation or reset, once, and then ends");
    c->now.mode = to;
    return fmiNOK;
}

static fmiNStatus advance(instance *c, double time, double step)
{
    int i;
    int faults;
    const double period = FMU_PERIOD;

    NEEDS((c != NULL) && !c->exchange, OTHER);
    NEEDS(c->now.mode == RUNNING, "a step needs an instance that is initialized and not terminated");
    NEEDS((step > 0.0) && isfinite(step) && isfinite(time), "a step must be longer than 0 s, and finite");
    if ((period > 0.0) && !(fabs(step - period) <= ((NEAR * period) + (1e-14 * fabs(time)))))
    {
        return say(c, fmiNDiscard, "a step of %.9g s is not the sample period of this law, %.9g s; step by that", step, period);
    }
    if (!(fabs(time - c->now.model.values[FMU_TIME]) <= ((0.001 * step) + (1e-12 * fabs(time)))))
    {
        return say(c, fmiNError, "a step from %.9g s, and the last one ended at %.9g s; go on from there", time,
                   c->now.model.values[FMU_TIME]);
    }
    for (i = 0; i < FMU_INPUTS; i++)
    {
        if ((FMU_STATES > 0) && !isfinite(c->now.model.values[i])) /* a sampled law holds its last finite input */
        {
            return say(c, fmiNError, "input %d is not a finite number; the step was not done", i);
        }
    }
    faults = fmu_step(&c->now.model, step);
    c->now.model.values[FMU_TIME] = time + step;
    if (faults > 0)
    {
        return say(c, fmiNWarning,
                   "%d value(s) were not finite at %.9g s; the step used the last finite input, or 0 for a sum that overflows",
                   faults, time);
    }
    return fmiNOK;
}

/* Creation, modes and variables. */

FMU_PUBLIC const char *fmiNGetVersion(void)
{
    return "N.0";
}

FMU_PUBLIC void fmiNFreeInstance(fmiNInstance c)
{
    free(c);
}

RETURNS(fmiNSetDebugLogging, (fmiNInstance c, fmiNBoolean on, size_t count, const fmiNString categories[]),
        (c == NULL) ? fmiNError : fmiNOK)
RETURNS(fmiNExitInitializationMode, (fmiNInstance c), initialize((instance *)c, INITIALIZING, RUNNING))

FMU_PUBLIC fmiNStatus fmiNTerminate(fmiNInstance c)
{
    NEEDS(c != NULL, "there is no instance");
    ((instance *)c)->now.mode = ENDED;
    return fmiNOK;
}

FMU_PUBLIC fmiNStatus fmiNReset(fmiNInstance c)
{
    NEEDS(c != NULL, "there is no instance");
    restart((instance *)c);
    return fmiNOK;
}

FMU_PUBLIC fmiNStatus fmiNGetFloat64(fmiNInstance c, const fmiNValueReference vr[], size_t count, fmiNFloat64 values[] ROOM)
{
    instance *one = (instance *)c;
    size_t i;

    NEEDS((c != NULL) && FITS(room, count), NUMBERS);
    fmu_update(&one->now.model);
    for (i = 0; i < count; i++)
    {
        if (vr[i] > FMU_TIME)
        {
            return say(one, fmiNError, "there is no variable with the value reference %u", (unsigned int)vr[i]);
        }
        values[i] = one->now.model.values[vr[i]];
    }
    return fmiNOK;
}

FMU_PUBLIC fmiNStatus fmiNSetFloat64(fmiNInstance c, const fmiNValueReference vr[], size_t count,
                                     const fmiNFloat64 values[] ROOM)
{
    instance *one = (instance *)c;
    size_t i;

    NEEDS((c != NULL) && FITS(room, count), NUMBERS);
    for (i = 0; i < count; i++)
    {
        const bool state = (vr[i] >= FMU_FIRST_STATE) && (vr[i] < FMU_FIRST_DERIVATIVE) && (one->now.mode != ENDED);

        if ((vr[i] >= FMU_INPUTS) && !state)
        {
            return say(one, fmiNError, "the variable with the value reference %u cannot be set now", (unsigned int)vr[i]);
        }
        one->now.model.values[vr[i]] = values[i];
    }
    return fmiNOK;
}

FMU_PUBLIC fmiNStatus fmiNGetDirectionalDerivative(fmiNInstance c, const fmiNValueReference unknowns[], size_t rows,
                                                   const fmiNValueReference knowns[], size_t columns,
                                                   const fmiNFloat64 seed[] SEEDS, fmiNFloat64 sensitivity[] SENSITIVITIES)
{
    NEEDS((c != NULL) && FITS(seeds, columns) && FITS(sensitivities, rows), NUMBERS);
#if FMU_STATES > 0
    for (size_t i = 0; i < rows; i++)
    {
        const bool output = (unknowns[i] >= FMU_INPUTS) && (unknowns[i] < FMU_FIRST_STATE);
        const double *slopes = fmu_slopes[unknowns[i] - (output ? FMU_INPUTS : FMU_INPUTS + FMU_STATES)];

        NEEDS(output || ((unknowns[i] >= FMU_FIRST_DERIVATIVE) && (unknowns[i] < FMU_TIME)),
              "an unknown of directional derivatives is an output or a state's derivative");
        sensitivity[i] = 0.0;
        for (size_t j = 0; j < columns; j++)
        {
            const bool input = knowns[j] < FMU_INPUTS;

            NEEDS(input || ((knowns[j] >= FMU_FIRST_STATE) && (knowns[j] < FMU_FIRST_DERIVATIVE)),
                  "a known of directional derivatives is an input or a state");
            sensitivity[i] += slopes[knowns[j] - (input ? 0U : FMU_OUTPUTS)] * seed[j];
        }
    }
    return fmiNOK;
#else
    return refuse(c, "a sampled law has no directional derivatives");
#endif
}

/* Copies of the state. */

FMU_PUBLIC fmiNStatus fmiNGetFMUState(fmiNInstance c, fmiNFMUState *state)
{
    if ((c != NULL) && (*state == NULL))
    {
        *state = malloc(sizeof(content));
    }
    NEEDS((c != NULL) && (*state != NULL), "there is no memory for a copy of the state");
    memcpy(*state, &((instance *)c)->now, sizeof(content));
    return fmiNOK;
}

FMU_PUBLIC fmiNStatus fmiNSetFMUState(fmiNInstance c, fmiNFMUState state)
{
    NEEDS((c != NULL) && (state != NULL), "there is no copy of a state to restore");
    memcpy(&((instance *)c)->now, state, sizeof(content));
    return fmiNOK;
}

FMU_PUBLIC fmiNStatus fmiNFreeFMUState(fmiNInstance c, fmiNFMUState *state)
{
    if (state != NULL)
    {
        free(*state);
        *state = NULL;
    }
    return (c == NULL) ? fmiNError : fmiNOK;
}

FMU_PUBLIC fmiNStatus fmiNSerializedFMUStateSize(fmiNInstance c, fmiNFMUState state, size_t *size)
{
    *size = sizeof(content);
    return (c == NULL) ? fmiNError : fmiNOK;
}

FMU_PUBLIC fmiNStatus fmiNSerializeFMUState(fmiNInstance c, fmiNFMUState state, fmiNByte bytes[], size_t size)
{
    NEEDS((c != NULL) && (state != NULL) && (size >= sizeof(content)), "there is no copy of a state, or no room for its bytes");
    memcpy(bytes, state, sizeof(content));
    return fmiNOK;
}

FMU_PUBLIC fmiNStatus fmiNDeserializeFMUState(fmiNInstance c, const fmiNByte bytes[], size_t size, fmiNFMUState *state)
{
    NEEDS((c != NULL) && (size == sizeof(content)), "these bytes are not a state of this FMU");
    *state = NULL;
    if (fmiNGetFMUState(c, state) == fmiNOK)
    {
        memcpy(*state, bytes, size);
    }
    return (*state == NULL) ? fmiNError : fmiNOK;
}

/* Model exchange. */

RETURNS(fmiNEnterEventMode, (fmiNInstance c), exchanging(c) ? fmiNOK : refuse(c, OTHER))
RETURNS(fmiNEnterContinuousTimeMode, (fmiNInstance c), exchanging(c) ? fmiNOK : refuse(c, OTHER))

FMU_PUBLIC fmiNStatus fmiNCompletedIntegratorStep(fmiNInstance c, fmiNBoolean no_set, fmiNBoolean *enter_event_mode,
                                                  fmiNBoolean *terminate)
{
    *enter_event_mode = false;
    *terminate = false;
    return exchanging(c) ? fmiNOK : refuse(c, OTHER);
}

FMU_PUBLIC fmiNStatus fmiNSetTime(fmiNInstance c, fmiNFloat64 time)
{
    NEEDS(exchanging(c), OTHER);
    ((instance *)c)->now.model.values[FMU_TIME] = time;
    return fmiNOK;
}

static fmiNStatus copied(fmiNInstance c, int first, double read[], const double written[], size_t count)
{
    double *values = NULL;

    NEEDS(exchanging(c), OTHER);
    NEEDS(count == (size_t)FMU_STATES, "the number of continuous states is another");
    values = &((instance *)c)->now.model.values[first];
    if (written != NULL)
    {
        memcpy(values, written, count * sizeof *written);
    }
    else
    {
        fmu_update(&((instance *)c)->now.model);
        memcpy(read, values, count * sizeof *read);
    }
    return fmiNOK;
}

RETURNS(fmiNSetContinuousStates, (fmiNInstance c, const fmiNFloat64 x[], size_t count),
        copied(c, FMU_FIRST_STATE, NULL, x, count))
RETURNS(fmiNGetContinuousStates, (fmiNInstance c, fmiNFloat64 x[], size_t count), copied(c, FMU_FIRST_STATE, x, NULL, count))
RETURNS(fmiNGetContinuousStateDerivatives, (fmiNInstance c, fmiNFloat64 derivatives[], size_t count),
        copied(c, FMU_FIRST_DERIVATIVE, derivatives, NULL, count))

FMU_PUBLIC fmiNStatus fmiNGetNominalsOfContinuousStates(fmiNInstance c, fmiNFloat64 nominals[], size_t count)
{
    size_t i;

    for (i = 0; i < count; i++)
    {
        nominals[i] = 1.0;
    }
    return exchanging(c) ? fmiNOK : refuse(c, OTHER);
}

RETURNS(fmiNGetEventIndicators, (fmiNInstance c, fmiNFloat64 indicators[], size_t count),
        (exchanging(c) && (count == 0U)) ? fmiNOK : refuse(c, "there are no event indicators"))

#if FMI_VERSION == 2

FMU_PUBLIC const char *fmi2GetTypesPlatform(void)
{
    return "default";
}

FMU_PUBLIC fmi2Component fmi2Instantiate(fmi2String name, fmi2Type kind, fmi2String guid, fmi2String resources,
                                         const fmi2CallbackFunctions *calls, fmi2Boolean visible, fmi2Boolean logging)
{
    return begun(name, guid, kind == fmi2ModelExchange, (calls == NULL) ? NULL : calls->componentEnvironment,
                 (calls == NULL) ? NULL : calls->logger);
}

FMU_PUBLIC fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean with_tolerance, fmi2Real tolerance, fmi2Real start,
                                          fmi2Boolean with_stop, fmi2Real stop)
{
    NEEDS(c != NULL, "there is no instance");
    ((instance *)c)->now.model.values[FMU_TIME] = start;
    return fmi2OK;
}

FMU_PUBLIC fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info)
{
    memset(info, 0, sizeof *info);
    return exchanging(c) ? fmiNOK : refuse(c, OTHER);
}

FMU_PUBLIC fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value)
{
    NEEDS((c != NULL) && (kind == fmi2LastSuccessfulTime), "fmi2GetRealStatus knows fmi2LastSuccessfulTime alone");
    *value = ((const instance *)c)->now.model.values[FMU_TIME];
    return fmi2OK;
}

FMU_PUBLIC fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value)
{
    *value = 0;
    return (kind == fmi2Terminated) ? fmi2OK : refuse(c, "fmi2GetBooleanStatus knows fmi2Terminated alone");
}

#define VARIABLES(type) (fmi2Component c, const fmi2ValueReference vr[], size_t count, type values[])
#define STATUS(type) (fmi2Component c, const fmi2StatusKind kind, type *value)
#define ORDERS(type) (fmi2Component c, const fmi2ValueReference vr[], size_t count, const fmi2Integer order[], type values[])

RETURNS(fmi2EnterInitializationMode, (fmi2Component c), initialize((instance *)c, NEW, INITIALIZING))
RETURNS(fmi2GetInteger, VARIABLES(fmi2Integer), (count == 0U) ? fmi2OK : refuse(c, NUMBERS))
RETURNS(fmi2GetBoolean, VARIABLES(fmi2Boolean), (count == 0U) ? fmi2OK : refuse(c, NUMBERS))
RETURNS(fmi2GetString, VARIABLES(fmi2String), (count == 0U) ? fmi2OK : refuse(c, NUMBERS))
RETURNS(fmi2SetInteger, VARIABLES(const fmi2Integer), (count == 0U) ? fmi2OK : refuse(c, NUMBERS))
RETURNS(fmi2SetBoolean, VARIABLES(const fmi2Boolean), (count == 0U) ? fmi2OK : refuse(c, NUMBERS))
RETURNS(fmi2SetString, VARIABLES(const fmi2String), (count == 0U) ? fmi2OK : refuse(c, NUMBERS))
RETURNS(fmi2SetRealInputDerivatives, ORDERS(const fmi2Real), refuse(c, "inputs are held over a step; they have no derivatives"))
RETURNS(fmi2GetRealOutputDerivatives, ORDERS(fmi2Real), refuse(c, "derivatives of outputs are not supported"))
RETURNS(fmi2CancelStep, (fmi2Component c), refuse(c, "no step is pending: every step is done when fmi2DoStep returns"))
RETURNS(fmi2DoStep, (fmi2Component c, fmi2Real time, fmi2Real step, fmi2Boolean no_set), advance((instance *)c, time, step))
RETURNS(fmi2GetStatus, STATUS(fmi2Status), refuse(c, "no step is pending: every step is done when fmi2DoStep returns"))
RETURNS(fmi2GetIntegerStatus, STATUS(fmi2Integer), refuse(c, "there is no status that is an Integer"))
RETURNS(fmi2GetStringStatus, STATUS(fmi2String), refuse(c, "there is no status that is a String"))

#else

FMU_PUBLIC fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources,
                                                     fmi3Boolean visible, fmi3Boolean logging,
                                                     fmi3InstanceEnvironment environment, fmi3LogMessageCallback log)
{
    return begun(name, token, true, environment, log);
}

FMU_PUBLIC fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources,
                                                    fmi3Boolean visible, fmi3Boolean logging, fmi3Boolean event_mode,
                                                    fmi3Boolean early_return, const fmi3ValueReference intermediate[],
                                                    size_t count, fmi3InstanceEnvironment environment,
                                                    fmi3LogMessageCallback log, fmi3IntermediateUpdateCallback update)
{
    return begun(name, token, false, environment, log);
}

FMU_PUBLIC fmi3Instance fmi3InstantiateScheduledExecution(fmi3String name, fmi3String token, fmi3String resources,
                                                          fmi3Boolean visible, fmi3Boolean logging,
                                                          fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                                          fmi3ClockUpdateCallback update, fmi3LockPreemptionCallback lock,
                                                          fmi3UnlockPreemptionCallback unlock)
{
    if (log != NULL)
    {
        log(environment, fmi3Error, "logStatusError", "scheduled execution is not supported");
    }
    return NULL;
}

FMU_PUBLIC fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean with_tolerance, fmi3Float64 tolerance,
                                                  fmi3Float64 start, fmi3Boolean with_stop, fmi3Float64 stop)
{
    const fmi3Status status = initialize((instance *)c, NEW, INITIALIZING);

    if (status == fmi3OK)
    {
        ((instance *)c)->now.model.values[FMU_TIME] = start;
    }
    return status;
}

FMU_PUBLIC fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 time, fmi3Float64 step, fmi3Boolean no_set,
                                 fmi3Boolean *event_needed, fmi3Boolean *terminate, fmi3Boolean *early,
                                 fmi3Float64 *last_time)
{
    const fmi3Status status = advance((instance *)c, time, step);

    *event_needed = false;
    *terminate = false;
    *early = false;
    *last_time = (c == NULL) ? time : ((const instance *)c)->now.model.values[FMU_TIME];
    return status;
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
    return exchanging(c) ? fmiNOK : refuse(c, OTHER);
}

FMU_PUBLIC fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance c, size_t *count)
{
    *count = 0U;
    return exchanging(c) ? fmiNOK : refuse(c, OTHER);
}

FMU_PUBLIC fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance c, size_t *count)
{
    *count = (size_t)FMU_STATES;
    return exchanging(c) ? fmiNOK : refuse(c, OTHER);
}

#define SOME fmi3Instance c, const fmi3ValueReference vr[], size_t count
#define NONE_OF(type)                                                                                                    \
    RETURNS(fmi3Get##type, (SOME, fmi3##type values[], size_t room), (count == 0U) ? fmi3OK : refuse(c, NUMBERS))        \
    RETURNS(fmi3Set##type, (SOME, const fmi3##type values[], size_t room), (count == 0U) ? fmi3OK : refuse(c, NUMBERS))
#define NO_CLOCK(function, ...)                                                                                          \
    RETURNS(function, (SOME, __VA_ARGS__), (count == 0U) ? fmi3OK : refuse(c, "there are no clocks"))

NONE_OF(Float32)
NONE_OF(Int8)
NONE_OF(UInt8)
NONE_OF(Int16)
NONE_OF(UInt16)
NONE_OF(Int32)
NONE_OF(UInt32)
NONE_OF(Int64)
NONE_OF(UInt64)
NONE_OF(Boolean)
NONE_OF(String)
RETURNS(fmi3GetBinary, (SOME, size_t lengths[], fmi3Binary values[], size_t room), (count == 0U) ? fmi3OK : refuse(c, NUMBERS))
RETURNS(fmi3SetBinary, (SOME, const size_t lengths[], const fmi3Binary values[], size_t room),
        (count == 0U) ? fmi3OK : refuse(c, NUMBERS))

NO_CLOCK(fmi3GetClock, fmi3Clock values[])
NO_CLOCK(fmi3SetClock, const fmi3Clock values[])
NO_CLOCK(fmi3GetIntervalDecimal, fmi3Float64 intervals[], fmi3IntervalQualifier qualifiers[])
NO_CLOCK(fmi3GetIntervalFraction, fmi3UInt64 counters[], fmi3UInt64 resolutions[], fmi3IntervalQualifier qualifiers[])
NO_CLOCK(fmi3GetShiftDecimal, fmi3Float64 shifts[])
NO_CLOCK(fmi3GetShiftFraction, fmi3UInt64 counters[], fmi3UInt64 resolutions[])
NO_CLOCK(fmi3SetIntervalDecimal, const fmi3Float64 intervals[])
NO_CLOCK(fmi3SetIntervalFraction, const fmi3UInt64 counters[], const fmi3UInt64 resolutions[])
NO_CLOCK(fmi3SetShiftDecimal, const fmi3Float64 shifts[])
NO_CLOCK(fmi3SetShiftFraction, const fmi3UInt64 counters[], const fmi3UInt64 resolutions[])

RETURNS(fmi3EvaluateDiscreteStates, (fmi3Instance c), exchanging(c) ? fmi3OK : refuse(c, OTHER))
RETURNS(fmi3EnterStepMode, (fmi3Instance c), refuse(c, "there is no event mode in this co-simulation"))
RETURNS(fmi3EnterConfigurationMode, (fmi3Instance c), refuse(c, "there are no structural parameters"))
RETURNS(fmi3ExitConfigurationMode, (fmi3Instance c), refuse(c, "there are no structural parameters"))
RETURNS(fmi3ActivateModelPartition, (fmi3Instance c, fmi3ValueReference clock, fmi3Float64 time),
        refuse(c, "scheduled execution is not supported"))
RETURNS(fmi3GetNumberOfVariableDependencies, (fmi3Instance c, fmi3ValueReference vr, size_t *count),
        refuse(c, "modelDescription.xml lists the dependencies"))
RETURNS(fmi3GetVariableDependencies,
        (fmi3Instance c, fmi3ValueReference dependent, size_t of_dependent[], fmi3ValueReference independents[],
         size_t of_independents[], fmi3DependencyKind kinds[], size_t count),
        refuse(c, "modelDescription.xml lists the dependencies"))
RETURNS(fmi3GetAdjointDerivative,
        (fmi3Instance c, const fmi3ValueReference unknowns[], size_t rows, const fmi3ValueReference knowns[], size_t columns,
         const fmi3Float64 seed[], size_t seeds, fmi3Float64 sensitivity[], size_t sensitivities),
        refuse(c, "adjoint derivatives are not supported; take directional ones"))
RETURNS(fmi3GetOutputDerivatives, (SOME, const fmi3Int32 orders[], fmi3Float64 values[], size_t room),
        refuse(c, "derivatives of outputs are not supported"))

#endif
