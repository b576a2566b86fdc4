/* The functions of an FMU's model. fmu_model.h, which is written for each FMU, has the model's type and sizes. */
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

void fmu_start(fmu_model *model);
void fmu_update(fmu_model *model); /* outputs and derivatives of inputs and states; of a sampled law nothing */
int fmu_step(fmu_model *model, double step); /* returns how many values of a sampled law were not finite */
double fmu_slope(int unknown, int known); /* the derivative of an output or state's derivative by an input or state */
extern const char *const fmu_inputs[FMU_INPUTS];

#endif
