/* The parts of an FMU that FMI 2 and FMI 3 share. fmu_model.h, which is written for each FMU, says what it holds. */
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
#define FMU_FIRST_OUTPUT FMU_INPUTS
#define FMU_FIRST_STATE (FMU_FIRST_OUTPUT + FMU_OUTPUTS)
#define FMU_FIRST_DERIVATIVE (FMU_FIRST_STATE + FMU_STATES)
#define FMU_TIME (FMU_FIRST_DERIVATIVE + FMU_STATES)

/* The numbers of both standards' states of an answer. */
enum { FMU_OK = 0, FMU_WARNING = 1, FMU_DISCARD = 2, FMU_ERROR = 3 };

typedef enum { FMU_NEW, FMU_INITIALIZING, FMU_RUNNING, FMU_ENDED } fmu_mode;

/* What is copied as the state of an instance. */
typedef struct
{
    fmu_model model;
    double time;
    fmu_mode mode;
} fmu_content;

typedef struct
{
    fmu_content now;
    char name[128];
    char said[256]; /* the line that is logged with an answer that is not OK */
} fmu_core;

/* Functions of the model, of fmu_model.c. */
void fmu_start(fmu_model *model);
void fmu_update(fmu_model *model); /* outputs and derivatives of inputs and states; of a sampled law nothing */
int fmu_step(fmu_model *model, double step); /* returns how many values of a sampled law were not finite */
double fmu_slope(int unknown, int known); /* the derivative of an output or state's derivative by an input or state */
extern const char *const fmu_inputs[FMU_INPUTS];

/* Functions of fmu.c; each returns FMU_OK, FMU_DISCARD or FMU_ERROR, and fmu_advance FMU_WARNING, too. */
void fmu_begin(fmu_core *core, const char *name);
const char *fmu_category(int status); /* of the log */
int fmu_refuse(fmu_core *core, int status, const char *why);
int fmu_get(fmu_core *core, const unsigned int *references, size_t count, double *values);
int fmu_set(fmu_core *core, const unsigned int *references, size_t count, const double *values);
int fmu_advance(fmu_core *core, double time, double step);
int fmu_initialize(fmu_core *core, int begin);
int fmu_states(fmu_core *core, int derivatives, double *values, size_t count);
int fmu_set_states(fmu_core *core, const double *values, size_t count);
int fmu_slopes(fmu_core *core, const unsigned int *unknowns, size_t rows, const unsigned int *knowns, size_t columns,
               const double *seed, double *sensitivity);
int fmu_keep(fmu_core *core, void **kept);
int fmu_restore(fmu_core *core, const void *kept);
int fmu_free_kept(fmu_core *core, void **kept);
int fmu_serialize(fmu_core *core, const void *kept, void *bytes, size_t size);
int fmu_deserialize(fmu_core *core, const void *bytes, size_t size, void **kept);

#endif
