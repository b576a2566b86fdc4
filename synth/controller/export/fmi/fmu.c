/* The parts of an FMU that FMI 2 and FMI 3 share: values by reference, steps, and copies of an instance's state. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include "fmu.h"

#define NEAR 1e-6 /* relative: a step is as long as the sample period within this; masters count time in other units */

void fmu_begin(fmu_core *core, const char *name)
{
    memset(&core->now, 0, sizeof core->now);
    if (name != NULL)
    {
        (void)snprintf(core->name, sizeof core->name, "%s", name);
    }
    core->said[0] = '\0';
    core->now.mode = FMU_NEW;
    fmu_start(&core->now.model);
    fmu_update(&core->now.model);
}

const char *fmu_category(int status)
{
    static const char *const CATEGORIES[] = {"logStatusWarning", "logStatusWarning", "logStatusDiscard", "logStatusError"};

    return CATEGORIES[status];
}

int fmu_refuse(fmu_core *core, int status, const char *why)
{
    (void)snprintf(core->said, sizeof core->said, "%s", why);
    return status;
}

int fmu_get(fmu_core *core, const unsigned int *references, size_t count, double *values)
{
    size_t i;

    fmu_update(&core->now.model);
    for (i = 0; i < count; i++)
    {
        const unsigned int r = references[i];

        if (r < FMU_FIRST_OUTPUT)
        {
            values[i] = core->now.model.u[r];
        }
        else if (r < FMU_FIRST_STATE)
        {
            values[i] = core->now.model.y[r - FMU_FIRST_OUTPUT];
        }
        else if (r < FMU_FIRST_DERIVATIVE)
        {
            values[i] = core->now.model.x[r - FMU_FIRST_STATE];
        }
        else if (r < FMU_TIME)
        {
            values[i] = core->now.model.dx[r - FMU_FIRST_DERIVATIVE];
        }
        else if (r == FMU_TIME)
        {
            values[i] = core->now.time;
        }
        else
        {
            (void)snprintf(core->said, sizeof core->said, "there is no variable with the value reference %u", r);
            return FMU_ERROR;
        }
    }
    return FMU_OK;
}

int fmu_set(fmu_core *core, const unsigned int *references, size_t count, const double *values)
{
    size_t i;

    for (i = 0; i < count; i++)
    {
        const unsigned int r = references[i];

        if (r < FMU_FIRST_OUTPUT)
        {
            core->now.model.u[r] = values[i];
        }
        else if ((r >= FMU_FIRST_STATE) && (r < FMU_FIRST_DERIVATIVE) && (core->now.mode != FMU_ENDED))
        {
            core->now.model.x[r - FMU_FIRST_STATE] = values[i];
        }
        else
        {
            (void)snprintf(core->said, sizeof core->said, "the variable with the value reference %u cannot be set now", r);
            return FMU_ERROR;
        }
    }
    return FMU_OK;
}

int fmu_initialize(fmu_core *core, int begin)
{
    if (core->now.mode != (begin ? FMU_NEW : FMU_INITIALIZING))
    {
        return fmu_refuse(core, FMU_ERROR, "initialization begins after instantiation or reset, once, and then ends");
    }
    core->now.mode = begin ? FMU_INITIALIZING : FMU_RUNNING;
    return FMU_OK;
}

int fmu_advance(fmu_core *core, double time, double step)
{
    int i;
    int faults;
    const double period = FMU_PERIOD;

    if (core->now.mode != FMU_RUNNING)
    {
        return fmu_refuse(core, FMU_ERROR, "a step needs an instance that is initialized and not terminated");
    }
    if (!(step > 0.0) || !isfinite(step) || !isfinite(time))
    {
        return fmu_refuse(core, FMU_ERROR, "a step must be longer than 0 s, and finite");
    }
    if ((period > 0.0) && !(fabs(step - period) <= ((NEAR * period) + (1e-14 * fabs(time)))))
    {
        (void)snprintf(core->said, sizeof core->said,
                       "a step of %.9g s is not the sample period of this law, %.9g s; step by that", step, period);
        return FMU_DISCARD;
    }
    if (!(fabs(time - core->now.time) <= ((0.001 * step) + (1e-12 * fabs(time)))))
    {
        (void)snprintf(core->said, sizeof core->said, "a step from %.9g s, and the last one ended at %.9g s; go on from there",
                       time, core->now.time);
        return FMU_ERROR;
    }
    for (i = 0; i < FMU_INPUTS; i++)
    {
        if ((FMU_STATES > 0) && !isfinite(core->now.model.u[i])) /* a sampled law holds its last finite input */
        {
            (void)snprintf(core->said, sizeof core->said, "input %s is not a finite number; the step was not done",
                           fmu_inputs[i]);
            return FMU_ERROR;
        }
    }
    faults = fmu_step(&core->now.model, step);
    core->now.time = time + step;
    if (faults > 0)
    {
        (void)snprintf(core->said, sizeof core->said,
                       "%d value(s) were not finite at %.9g s; the step used the last finite input, or 0 for a sum that overflows",
                       faults, time);
        return FMU_WARNING;
    }
    return FMU_OK;
}

int fmu_states(fmu_core *core, int derivatives, double *values, size_t count)
{
    if (count != (size_t)FMU_STATES)
    {
        return fmu_refuse(core, FMU_ERROR, "the number of continuous states is another");
    }
    fmu_update(&core->now.model);
    if (count > 0U)
    {
        memcpy(values, derivatives ? core->now.model.dx : core->now.model.x, count * sizeof *values);
    }
    return FMU_OK;
}

int fmu_set_states(fmu_core *core, const double *values, size_t count)
{
    if (count != (size_t)FMU_STATES)
    {
        return fmu_refuse(core, FMU_ERROR, "the number of continuous states is another");
    }
    if (count > 0U)
    {
        memcpy(core->now.model.x, values, count * sizeof *values);
    }
    return FMU_OK;
}

int fmu_slopes(fmu_core *core, const unsigned int *unknowns, size_t rows, const unsigned int *knowns, size_t columns,
               const double *seed, double *sensitivity)
{
    size_t i;
    size_t j;

    if (FMU_STATES == 0)
    {
        return fmu_refuse(core, FMU_ERROR, "a sampled law has no directional derivatives");
    }
    for (i = 0; i < rows; i++)
    {
        int unknown = (int)unknowns[i] - FMU_FIRST_OUTPUT;

        if (unknowns[i] >= FMU_FIRST_DERIVATIVE)
        {
            unknown = (int)unknowns[i] - FMU_FIRST_DERIVATIVE + FMU_OUTPUTS;
        }
        else if (unknowns[i] >= FMU_FIRST_STATE)
        {
            unknown = -1;
        }
        else
        {
            /* an output, or less than one */
        }
        if ((unknown < 0) || (unknowns[i] >= FMU_TIME))
        {
            return fmu_refuse(core, FMU_ERROR, "an unknown of directional derivatives is an output or a state's derivative");
        }
        sensitivity[i] = 0.0;
        for (j = 0; j < columns; j++)
        {
            int known = (int)knowns[j];

            if ((known >= FMU_FIRST_STATE) && (known < FMU_FIRST_DERIVATIVE))
            {
                known = known - FMU_FIRST_STATE + FMU_INPUTS;
            }
            else if ((known < 0) || (known >= FMU_INPUTS))
            {
                return fmu_refuse(core, FMU_ERROR, "a known of directional derivatives is an input or a state");
            }
            else
            {
                /* an input */
            }
            sensitivity[i] += fmu_slope(unknown, known) * seed[j];
        }
    }
    return FMU_OK;
}

int fmu_keep(fmu_core *core, void **kept)
{
    if (*kept == NULL)
    {
        *kept = malloc(sizeof(fmu_content));
    }
    if (*kept == NULL)
    {
        return fmu_refuse(core, FMU_ERROR, "there is no memory for a copy of the state");
    }
    memcpy(*kept, &core->now, sizeof core->now);
    return FMU_OK;
}

int fmu_restore(fmu_core *core, const void *kept)
{
    if (kept == NULL)
    {
        return fmu_refuse(core, FMU_ERROR, "there is no copy of a state to restore");
    }
    memcpy(&core->now, kept, sizeof core->now);
    return FMU_OK;
}

int fmu_free_kept(fmu_core *core, void **kept)
{
    (void)core;
    if (kept != NULL)
    {
        free(*kept);
        *kept = NULL;
    }
    return FMU_OK;
}

int fmu_serialize(fmu_core *core, const void *kept, void *bytes, size_t size)
{
    if ((kept == NULL) || (size < sizeof(fmu_content)))
    {
        return fmu_refuse(core, FMU_ERROR, "there is no copy of a state, or no room for its bytes");
    }
    memcpy(bytes, kept, sizeof(fmu_content));
    return FMU_OK;
}

int fmu_deserialize(fmu_core *core, const void *bytes, size_t size, void **kept)
{
    if (size != sizeof(fmu_content))
    {
        return fmu_refuse(core, FMU_ERROR, "these bytes are no state of this FMU");
    }
    *kept = malloc(sizeof(fmu_content));
    if (*kept == NULL)
    {
        return fmu_refuse(core, FMU_ERROR, "there is no memory for a copy of the state");
    }
    memcpy(*kept, bytes, sizeof(fmu_content));
    return FMU_OK;
}
