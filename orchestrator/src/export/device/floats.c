
#if LAYERS > 1
/* What a layer hands on of its sums. */
static void hand_on(const layer *of)
{
    for (int o = 0; o < of->out; o++) made[o] = sums[o] > 0.0f ? sums[o] : 0.0f;
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
