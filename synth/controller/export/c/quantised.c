/* Rounds to the nearest step, ties to even. A value too large to have a fraction is a step already. */
static NUMBER PREFIX_quantised(NUMBER value, NUMBER step)
{
    NUMBER count = value / step;

    if ((count >= ZERO) && (count < LARGE))
    {
        volatile NUMBER sum = count + LARGE;
        count = sum - LARGE;
    }
    else if ((count < ZERO) && (count > -LARGE))
    {
        volatile NUMBER sum = count - LARGE;
        count = sum + LARGE;
    }
    else
    {
        /* the count is unchanged */
    }
    return step * count;
}
