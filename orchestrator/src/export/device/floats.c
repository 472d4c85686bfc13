
#if LAYERS > 1
/* What a layer hands on of a sum. */
static value handed(const layer *of, int o, int whole)
{
    (void)of;
    return sums[o] > 0.0f || whole ? sums[o] : 0.0f;
}
#endif

static void take(const float *reading, value *input)
{
    for (int c = 0; c < BRAIN_CHANNELS; c++) input[c] = reading[c];
}

static void tell(float *force)
{
    for (int k = 0; k < BRAIN_PANELS; k++) force[k] = sums[k];
}
