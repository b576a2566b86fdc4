/* The model of an FMU. fmu_model.h, which is written for each FMU, has its sizes, and the state of its law if it has one. */
#ifndef FMU_H
#define FMU_H

#include <stddef.h>
#include "fmu_model.h"

#if defined(_WIN32)
#define FMU_PUBLIC __declspec(dllexport)
#elif defined(__GNUC__)
#define FMU_PUBLIC __attribute__((visibility("default")))
#else
#define FMU_PUBLIC
#endif

/* Values by reference: inputs, outputs, states, their derivatives, time. */
#define FMU_FIRST_STATE (FMU_INPUTS + FMU_OUTPUTS)
#define FMU_FIRST_DERIVATIVE (FMU_FIRST_STATE + FMU_STATES)
#define FMU_TIME (FMU_FIRST_DERIVATIVE + FMU_STATES)

typedef struct
{
    double values[FMU_TIME + 1];
#if FMU_STATES == 0
    fmu_law law;
#endif
} fmu_model;

void fmu_start(fmu_model *model);  /* of values that are 0 */
void fmu_update(fmu_model *model); /* outputs and derivatives of inputs and states; of a sampled law nothing */
int fmu_step(fmu_model *model, double step); /* returns how many values of a sampled law were not finite */
#if FMU_STATES > 0
/* Slopes of outputs, then states' derivatives, by inputs, then states. */
extern const double fmu_slopes[FMU_OUTPUTS + FMU_STATES][FMU_INPUTS + FMU_STATES];
#endif

#endif
