
#if LAYERS > 1
/* What a layer hands on of a sum, in steps of the next one's inputs, to the nearest. No product passes 2^62. */
static value handed(const layer *of, int o, int whole)
{
    int64_t y = sums[o] > 0 ? sums[o] : whole ? -(int64_t)sums[o] : 0;
    y = (y * of->factor[o] + ((int64_t)1 << (of->shift[o] - 1))) >> of->shift[o];
    y = y < GREATEST ? y : GREATEST;
    return (value)(sums[o] < 0 ? -y : y);
}
#endif

/* Readings in steps, to the nearest: a float is multiplied and cut off, which every compiler does to the same bits. */
static void take(const float *reading, value *input)
{
    for (int c = 0; c < BRAIN_CHANNELS; c++) {
        const float end = 2.0f * GREATEST, half = reading[c] * HALF_STEPS[c];
        int32_t h = (int32_t)(half >= end ? end : half <= -end ? -end : half == half ? half : 0.0f);
        input[c] = (value)((h + (h < 0 ? -1 : 1)) / 2);
    }
}

static void tell(float *force)
{
    for (int k = 0; k < BRAIN_PANELS; k++) force[k] = (float)sums[k] * FORCE[k];
}
