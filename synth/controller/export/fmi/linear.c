/* A linear system x' = A x + B u, y = C x + D u, whose step is exact for inputs that are held. */
#include <math.h>
#include "fmu.h"

#define TERMS 20 /* of a series in the step, where the matrix is at most 1: the rest is below 1e-18 */

void fmu_start(fmu_model *model)
{
    (void)model; /* it is at rest */
}

void fmu_update(fmu_model *model)
{
    int i;
    int j;

    for (i = 0; i < (FMU_OUTPUTS + FMU_STATES); i++)
    {
        double sum = 0.0;

        for (j = 0; j < FMU_STATES; j++)
        {
            sum += fmu_slopes[i][FMU_INPUTS + j] * model->values[FMU_FIRST_STATE + j];
        }
        for (j = 0; j < FMU_INPUTS; j++)
        {
            sum += fmu_slopes[i][j] * model->values[j];
        }
        model->values[FMU_INPUTS + i + ((i < FMU_OUTPUTS) ? 0 : FMU_STATES)] = sum;
    }
}

/* Adds the series h x' + h^2 A x' / 2 + h^3 A^2 x' / 6 + ... to the states. */
static void advance(fmu_model *model, double h)
{
    double term[FMU_STATES];
    double next[FMU_STATES];
    int i;
    int j;
    int n;

    fmu_update(model);
    for (i = 0; i < FMU_STATES; i++)
    {
        term[i] = h * model->values[FMU_FIRST_DERIVATIVE + i];
    }
    for (n = 2; n <= TERMS; n++)
    {
        for (i = 0; i < FMU_STATES; i++)
        {
            next[i] = 0.0;
            for (j = 0; j < FMU_STATES; j++)
            {
                next[i] += (h / n) * fmu_slopes[FMU_OUTPUTS + i][FMU_INPUTS + j] * term[j];
            }
        }
        for (i = 0; i < FMU_STATES; i++)
        {
            model->values[FMU_FIRST_STATE + i] += term[i];
            term[i] = next[i];
        }
    }
}

int fmu_step(fmu_model *model, double step)
{
    const double parts = ceil(step * FMU_RATE);
    double part;

    for (part = 0.0; part < parts; part += 1.0)
    {
        advance(model, step / parts);
    }
    return 0;
}
