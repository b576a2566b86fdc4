/* Divides a sum by 2^shift, rounds to the nearest integer (ties away from 0), and clips to +-most. */
static NUMBER PREFIX_rounded(int64_t total, int shift, int64_t most)
{
    const int64_t half = (shift > 0) ? ((int64_t)1 << (shift - 1)) : 0;
    int64_t result = (total >= 0) ? ((total + half) >> shift) : -((half - total) >> shift);

    if (result > most)
    {
        result = most;
    }
    else if (result < -most)
    {
        result = -most;
    }
    else
    {
        /* the result is unchanged */
    }
    return (NUMBER)result;
}
