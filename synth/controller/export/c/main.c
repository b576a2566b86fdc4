/* Back-to-back test with vectors.csv: every output must equal the file bit for bit. */
#include <stdio.h>
#include <stdlib.h>
#include "../PREFIX.h"

int main(int argc, char **argv)
{
    static char line[LONGEST];
    PREFIX_state state;
    PREFIX_in in;
    PREFIX_out out;
    long samples = 0L;
    long differ = 0L;
    FILE *file = fopen((argc > 1) ? argv[1] : "vectors.csv", "r");

    if ((file == NULL) || (fgets(line, (int)sizeof line, file) == NULL))
    {
        (void)fprintf(stderr, "vectors.csv cannot be read; give its path\n");
        return 2;
    }
    PREFIX_init(&state);
    while (fgets(line, (int)sizeof line, file) != NULL)
    {
        char *at = line;

INPUTS
        PREFIX_step(&state, &in, &out);
OUTPUTS
        samples++;
    }
    (void)fclose(file);
    (void)printf("%ld samples, %ld outputs differ\n", samples, differ);
    return (differ == 0L) ? 0 : 1;
}
