/* All functions of FMI 2.0. What is not supported returns fmi2Error and logs one line. */
#include <stdlib.h>
#include <string.h>
#include "fmu.h"

#if defined(FMU_STANDARD_HEADERS)
#include "fmi2Functions.h" /* to compare the declarations with the standard's */
#else
/* The types of the standard, as far as they are needed. */
typedef void *fmi2Component;
typedef void *fmi2ComponentEnvironment;
typedef void *fmi2FMUstate;
typedef unsigned int fmi2ValueReference;
typedef double fmi2Real;
typedef int fmi2Integer;
typedef int fmi2Boolean;
typedef const char *fmi2String;
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
#endif

typedef struct
{
    fmu_core core;
    const fmi2CallbackFunctions *calls;
    fmi2Type kind;
    fmi2Status last;
} instance;

/* Logs what went wrong, and returns the status. */
static fmi2Status answer(instance *one, int status)
{
    if ((status != FMU_OK) && (one->calls != NULL) && (one->calls->logger != NULL))
    {
        one->calls->logger(one->calls->componentEnvironment, one->core.name, (fmi2Status)status, fmu_category(status),
                           one->core.said);
    }
    return (fmi2Status)status;
}

static fmi2Status refuse(fmi2Component c, const char *why)
{
    instance *one = (instance *)c;

    return (one == NULL) ? fmi2Error : answer(one, fmu_refuse(&one->core, FMU_ERROR, why));
}

/* A function that needs model exchange, or co-simulation, is refused to an instance of the other kind. */
static int is_of(fmi2Component c, fmi2Type kind)
{
    const instance *one = (const instance *)c;

    return (one != NULL) && (one->kind == kind);
}

static const char OTHER[] = "this function is of the other kind of FMI: co-simulation or model exchange";
static const char REALS[] = "all variables are Real; there are none of another type";

FMU_PUBLIC const char *fmi2GetTypesPlatform(void)
{
    return "default";
}

FMU_PUBLIC const char *fmi2GetVersion(void)
{
    return "2.0";
}

FMU_PUBLIC fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t count, const fmi2String categories[])
{
    (void)on;
    (void)count;
    (void)categories;
    return (c == NULL) ? fmi2Error : fmi2OK;
}

FMU_PUBLIC fmi2Component fmi2Instantiate(fmi2String name, fmi2Type kind, fmi2String guid, fmi2String resources,
                                         const fmi2CallbackFunctions *calls, fmi2Boolean visible, fmi2Boolean logging)
{
    const char *why = NULL;
    instance *one = NULL;

    (void)resources;
    (void)visible;
    (void)logging;
    if ((guid == NULL) || (strcmp(guid, FMU_TOKEN) != 0))
    {
        why = "the GUID is not the one of modelDescription.xml";
    }
    else if ((kind == fmi2ModelExchange) && (FMU_STATES == 0))
    {
        why = "this FMU is for co-simulation alone";
    }
    else
    {
        one = (instance *)calloc(1, sizeof *one);
        why = (one == NULL) ? "there is no memory for an instance" : NULL;
    }
    if ((why != NULL) && (calls != NULL) && (calls->logger != NULL))
    {
        calls->logger(calls->componentEnvironment, name, fmi2Error, "logStatusError", why);
    }
    if (one != NULL)
    {
        one->calls = calls;
        one->kind = kind;
        fmu_begin(&one->core, name);
    }
    return one;
}

FMU_PUBLIC void fmi2FreeInstance(fmi2Component c)
{
    free(c);
}

FMU_PUBLIC fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean with_tolerance, fmi2Real tolerance, fmi2Real start,
                                          fmi2Boolean with_stop, fmi2Real stop)
{
    instance *one = (instance *)c;

    (void)with_tolerance;
    (void)tolerance;
    (void)with_stop;
    (void)stop;
    if (one == NULL)
    {
        return fmi2Error;
    }
    one->core.now.time = start;
    return fmi2OK;
}

FMU_PUBLIC fmi2Status fmi2EnterInitializationMode(fmi2Component c)
{
    instance *one = (instance *)c;

    return (one == NULL) ? fmi2Error : answer(one, fmu_initialize(&one->core, 1));
}

FMU_PUBLIC fmi2Status fmi2ExitInitializationMode(fmi2Component c)
{
    instance *one = (instance *)c;

    return (one == NULL) ? fmi2Error : answer(one, fmu_initialize(&one->core, 0));
}

FMU_PUBLIC fmi2Status fmi2Terminate(fmi2Component c)
{
    instance *one = (instance *)c;

    if (one == NULL)
    {
        return fmi2Error;
    }
    one->core.now.mode = FMU_ENDED;
    return fmi2OK;
}

FMU_PUBLIC fmi2Status fmi2Reset(fmi2Component c)
{
    instance *one = (instance *)c;

    if (one == NULL)
    {
        return fmi2Error;
    }
    fmu_begin(&one->core, NULL);
    one->last = fmi2OK;
    return fmi2OK;
}

FMU_PUBLIC fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t count, fmi2Real values[])
{
    instance *one = (instance *)c;

    return (one == NULL) ? fmi2Error : answer(one, fmu_get(&one->core, vr, count, values));
}

FMU_PUBLIC fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t count, const fmi2Real values[])
{
    instance *one = (instance *)c;

    return (one == NULL) ? fmi2Error : answer(one, fmu_set(&one->core, vr, count, values));
}

#define NONE_OF(function, type)                                                                                       \
    FMU_PUBLIC fmi2Status function(fmi2Component c, const fmi2ValueReference vr[], size_t count, type values[])       \
    {                                                                                                                 \
        (void)vr;                                                                                                     \
        (void)values;                                                                                                 \
        return ((c != NULL) && (count == 0U)) ? fmi2OK : refuse(c, REALS);                                            \
    }

NONE_OF(fmi2GetInteger, fmi2Integer)
NONE_OF(fmi2GetBoolean, fmi2Boolean)
NONE_OF(fmi2GetString, fmi2String)
NONE_OF(fmi2SetInteger, const fmi2Integer)
NONE_OF(fmi2SetBoolean, const fmi2Boolean)
NONE_OF(fmi2SetString, const fmi2String)

FMU_PUBLIC fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state)
{
    instance *one = (instance *)c;

    return (one == NULL) ? fmi2Error : answer(one, fmu_keep(&one->core, state));
}

FMU_PUBLIC fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state)
{
    instance *one = (instance *)c;

    return (one == NULL) ? fmi2Error : answer(one, fmu_restore(&one->core, state));
}

FMU_PUBLIC fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state)
{
    instance *one = (instance *)c;

    return (one == NULL) ? fmi2Error : answer(one, fmu_free_kept(&one->core, state));
}

FMU_PUBLIC fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate state, size_t *size)
{
    (void)state;
    *size = sizeof(fmu_content);
    return (c == NULL) ? fmi2Error : fmi2OK;
}

FMU_PUBLIC fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size)
{
    instance *one = (instance *)c;

    return (one == NULL) ? fmi2Error : answer(one, fmu_serialize(&one->core, state, bytes, size));
}

FMU_PUBLIC fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state)
{
    instance *one = (instance *)c;

    return (one == NULL) ? fmi2Error : answer(one, fmu_deserialize(&one->core, bytes, size, state));
}

FMU_PUBLIC fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference unknowns[], size_t rows,
                                                   const fmi2ValueReference knowns[], size_t columns, const fmi2Real seed[],
                                                   fmi2Real sensitivity[])
{
    instance *one = (instance *)c;

    return (one == NULL) ? fmi2Error
                         : answer(one, fmu_slopes(&one->core, unknowns, rows, knowns, columns, seed, sensitivity));
}

/* Model exchange. */

FMU_PUBLIC fmi2Status fmi2EnterEventMode(fmi2Component c)
{
    return is_of(c, fmi2ModelExchange) ? fmi2OK : refuse(c, OTHER);
}

FMU_PUBLIC fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info)
{
    memset(info, 0, sizeof *info);
    return is_of(c, fmi2ModelExchange) ? fmi2OK : refuse(c, OTHER);
}

FMU_PUBLIC fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c)
{
    return is_of(c, fmi2ModelExchange) ? fmi2OK : refuse(c, OTHER);
}

FMU_PUBLIC fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean no_set, fmi2Boolean *enter_event_mode,
                                                  fmi2Boolean *terminate)
{
    (void)no_set;
    *enter_event_mode = 0;
    *terminate = 0;
    return is_of(c, fmi2ModelExchange) ? fmi2OK : refuse(c, OTHER);
}

FMU_PUBLIC fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time)
{
    if (!is_of(c, fmi2ModelExchange))
    {
        return refuse(c, OTHER);
    }
    ((instance *)c)->core.now.time = time;
    return fmi2OK;
}

FMU_PUBLIC fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t count)
{
    instance *one = (instance *)c;

    return is_of(c, fmi2ModelExchange) ? answer(one, fmu_set_states(&one->core, x, count)) : refuse(c, OTHER);
}

FMU_PUBLIC fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real derivatives[], size_t count)
{
    instance *one = (instance *)c;

    return is_of(c, fmi2ModelExchange) ? answer(one, fmu_states(&one->core, 1, derivatives, count)) : refuse(c, OTHER);
}

FMU_PUBLIC fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real indicators[], size_t count)
{
    (void)indicators;
    return (is_of(c, fmi2ModelExchange) && (count == 0U)) ? fmi2OK : refuse(c, "there are no event indicators");
}

FMU_PUBLIC fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t count)
{
    instance *one = (instance *)c;

    return is_of(c, fmi2ModelExchange) ? answer(one, fmu_states(&one->core, 0, x, count)) : refuse(c, OTHER);
}

FMU_PUBLIC fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real nominals[], size_t count)
{
    size_t i;

    for (i = 0; i < count; i++)
    {
        nominals[i] = 1.0;
    }
    return is_of(c, fmi2ModelExchange) ? fmi2OK : refuse(c, OTHER);
}

/* Co-simulation. */

FMU_PUBLIC fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t count,
                                                  const fmi2Integer order[], const fmi2Real values[])
{
    (void)vr;
    (void)count;
    (void)order;
    (void)values;
    return refuse(c, "inputs are held over a step; their derivatives are not supported");
}

FMU_PUBLIC fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t count,
                                                   const fmi2Integer order[], fmi2Real values[])
{
    (void)vr;
    (void)count;
    (void)order;
    (void)values;
    return refuse(c, "derivatives of outputs are not supported");
}

FMU_PUBLIC fmi2Status fmi2DoStep(fmi2Component c, fmi2Real time, fmi2Real step, fmi2Boolean no_set)
{
    instance *one = (instance *)c;

    (void)no_set;
    if (!is_of(c, fmi2CoSimulation))
    {
        return refuse(c, OTHER);
    }
    one->last = answer(one, fmu_advance(&one->core, time, step));
    return one->last;
}

FMU_PUBLIC fmi2Status fmi2CancelStep(fmi2Component c)
{
    return refuse(c, "no step is pending: every step is done when fmi2DoStep returns");
}

FMU_PUBLIC fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Status *value)
{
    if (!is_of(c, fmi2CoSimulation) || (kind != fmi2DoStepStatus))
    {
        return refuse(c, "fmi2GetStatus knows fmi2DoStepStatus alone");
    }
    *value = ((const instance *)c)->last;
    return fmi2OK;
}

FMU_PUBLIC fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value)
{
    if (!is_of(c, fmi2CoSimulation) || (kind != fmi2LastSuccessfulTime))
    {
        return refuse(c, "fmi2GetRealStatus knows fmi2LastSuccessfulTime alone");
    }
    *value = ((const instance *)c)->core.now.time;
    return fmi2OK;
}

FMU_PUBLIC fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Integer *value)
{
    (void)kind;
    (void)value;
    return refuse(c, "there is no status that is an Integer");
}

FMU_PUBLIC fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value)
{
    if (!is_of(c, fmi2CoSimulation) || (kind != fmi2Terminated))
    {
        return refuse(c, "fmi2GetBooleanStatus knows fmi2Terminated alone");
    }
    *value = 0;
    return fmi2OK;
}

FMU_PUBLIC fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind kind, fmi2String *value)
{
    (void)kind;
    (void)value;
    return refuse(c, "there is no status that is a String");
}
