/* A linear system x' = A x + B u, y = C x + D u, whose step is exact for inputs that are held. */
#include <math.h>
#include <string.h>
#include "fmu.h"
#include "fmu_tables.h"

#define ALL (FMU_STATES + FMU_INPUTS)
#define TERMS 20 /* of a matrix exponential's series, where the matrix is below a half: the rest is below 1e-25 */

void fmu_start(fmu_model *model)
{
    memset(model, 0, sizeof *model);
}

double fmu_slope(int unknown, int known)
{
    double slope;

    if (unknown < FMU_OUTPUTS)
    {
        slope = (known < FMU_INPUTS) ? fmu_D[unknown][known] : fmu_C[unknown][known - FMU_INPUTS];
    }
    else
    {
        const int row = unknown - FMU_OUTPUTS;

        slope = (known < FMU_INPUTS) ? fmu_B[row][known] : fmu_A[row][known - FMU_INPUTS];
    }
    return slope;
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
            sum += fmu_slope(i, FMU_INPUTS + j) * model->x[j];
        }
        for (j = 0; j < FMU_INPUTS; j++)
        {
            sum += fmu_slope(i, j) * model->u[j];
        }
        if (i < FMU_OUTPUTS)
        {
            model->y[i] = sum;
        }
        else
        {
            model->dx[i - FMU_OUTPUTS] = sum;
        }
    }
}

static void multiply(double into[ALL][ALL], double a[ALL][ALL], double b[ALL][ALL])
{
    int i;
    int j;
    int k;

    for (i = 0; i < ALL; i++)
    {
        for (j = 0; j < ALL; j++)
        {
            double sum = 0.0;

            for (k = 0; k < ALL; k++)
            {
                sum += a[i][k] * b[k][j];
            }
            into[i][j] = sum;
        }
    }
}

/* Fills in what takes states and held inputs over a step: the exponential of [A B; 0 0] h, less the identity. */
static void prepare(fmu_model *model, double step)
{
    static const double HALF = 0.5;
    double small[ALL][ALL];
    double term[ALL][ALL];
    double sum[ALL][ALL];
    double next[ALL][ALL];
    double largest = 0.0;
    double scale = step;
    int halvings = 0;
    int i;
    int j;
    int n;

    for (i = 0; i < FMU_STATES; i++)
    {
        double row = 0.0;

        for (j = 0; j < ALL; j++)
        {
            row += fabs((j < FMU_STATES) ? fmu_A[i][j] : fmu_B[i][j - FMU_STATES]);
        }
        largest = (row > largest) ? row : largest;
    }
    while (((largest * scale) > HALF) && (halvings < 200))
    {
        scale *= HALF;
        halvings++;
    }
    memset(small, 0, sizeof small);
    for (i = 0; i < FMU_STATES; i++)
    {
        for (j = 0; j < ALL; j++)
        {
            small[i][j] = scale * ((j < FMU_STATES) ? fmu_A[i][j] : fmu_B[i][j - FMU_STATES]);
        }
    }
    memcpy(sum, small, sizeof sum);
    memcpy(term, small, sizeof term);
    for (n = 2; n < TERMS; n++)
    {
        multiply(next, term, small);
        for (i = 0; i < ALL; i++)
        {
            for (j = 0; j < ALL; j++)
            {
                term[i][j] = next[i][j] / (double)n;
                sum[i][j] += term[i][j];
            }
        }
    }
    for (n = 0; n < halvings; n++) /* (I + S)^2 - I = 2 S + S^2: nothing is lost to the identity */
    {
        multiply(next, sum, sum);
        for (i = 0; i < ALL; i++)
        {
            for (j = 0; j < ALL; j++)
            {
                sum[i][j] = (2.0 * sum[i][j]) + next[i][j];
            }
        }
    }
    for (i = 0; i < FMU_STATES; i++)
    {
        memcpy(model->over[i], sum[i], sizeof model->over[i]);
    }
    model->step = step;
}

int fmu_step(fmu_model *model, double step)
{
    double x[FMU_STATES];
    int i;
    int j;

    if (!(fabs(model->step - step) <= (1e-12 * step))) /* masters count time, and lose its last digits */
    {
        prepare(model, step);
    }
    for (i = 0; i < FMU_STATES; i++)
    {
        x[i] = model->x[i];
        for (j = 0; j < FMU_STATES; j++)
        {
            x[i] += model->over[i][j] * model->x[j];
        }
        for (j = 0; j < FMU_INPUTS; j++)
        {
            x[i] += model->over[i][FMU_STATES + j] * model->u[j];
        }
    }
    memcpy(model->x, x, sizeof x);
    return 0;
}
