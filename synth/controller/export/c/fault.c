/* Copies a finite value. Returns 1, and copies nothing, if the value is infinite or not a number. */
static int PREFIX_fault(NUMBER value, NUMBER *copy)
{
    int fault = 1;

    if ((value < MOST) && (-value < MOST))
    {
        *copy = value;
        fault = 0;
    }
    return fault;
}
