static NUMBER PREFIX_clipped(NUMBER value, NUMBER low, NUMBER high)
{
    NUMBER result = value;

    if (value < low)
    {
        result = low;
    }
    else if (value > high)
    {
        result = high;
    }
    else
    {
        /* the value is unchanged */
    }
    return result;
}
