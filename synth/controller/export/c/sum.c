/* Adds the products of a row and a column, from the first entry to the last. */
static TOTAL PREFIX_sum(TOTAL start, const NUMBER *row, const NUMBER *column, int count)
{
    TOTAL total = start;
    int i;

    for (i = 0; i < count; i++)
    {
        total = total + (PRODUCT);
    }
    return total;
}
