
static float sums[OUTPUTS];
static int known, rest;

void brain_reset(void)
{
    known = rest = 0;
}

int brain_read(const float *reading, float *estimates)
{
    float scaled[BRAIN_CHANNELS];
    int contact = 0;
    for (int c = 0; c < BRAIN_CHANNELS; c++) {
        scaled[c] = reading[c] / SCALE[c];
        contact |= reading[c] > TRIGGER[c] || -reading[c] > TRIGGER[c];
    }
    if (known == 0) {
        if (rest > 0) {
            rest = contact ? REST : rest - 1;
            return 0;
        }
        if (!contact) return 0;
    }
    for (int o = 0; o < OUTPUTS; o++) {
        const weight *w = W + (o * BLOCKS + known / BLOCK) * BRAIN_CHANNELS;
        if (known == 0) sums[o] = 0.0f;
        for (int c = 0; c < BRAIN_CHANNELS; c++) sums[o] += (float)w[c] * scaled[c];
    }
    if (++known < BRAIN_INSTANTS) return 0;
    known = 0;
    rest = REST;
    for (int o = 0; o < OUTPUTS; o++) sums[o] = B[o] + STEP[o] * sums[o];
    /* the label of each task: the values, or the class of the greatest output; of two classes the first, if above 0 */
    const float *output = sums, *classes = CLASS;
    for (int t = 0; t < TASKS; t++) {
        int best = 0;
        for (int o = 0; o < COUNT[t]; o++) {
            if (KIND[t] == 0) *estimates++ = output[o];
            else if (output[o] > output[best]) best = o;
        }
        if (KIND[t] == 2) best = output[0] > 0.0f ? 0 : 1;
        if (KIND[t] > 0) *estimates++ = classes[best];
        output += COUNT[t];
        classes += KIND[t];
    }
    return 1;
}

#ifdef BRAIN_TEST
#include <stdio.h>

int main(void)
{
    float greatest = 0.0f, estimates[BRAIN_ESTIMATES];
    int told = 0, further = 0;
    for (int n = 0, answered = 0; n < VALUES / BRAIN_CHANNELS; n++) {
        if (n % (VALUES / SAMPLES / BRAIN_CHANNELS) == 0) brain_reset(), answered = 0;
        if (!brain_read(SIGNALS + n * BRAIN_CHANNELS, estimates)) continue;
        if (answered++) {
            further++;
            continue;
        }
        for (int e = 0; e < BRAIN_ESTIMATES; e++) {
            float off = (estimates[e] - ESTIMATES[told * BRAIN_ESTIMATES + e]) / BOUND[e];
            off = off < 0.0f ? -off : off;
            if (!(off <= greatest)) greatest = off;
        }
        told++;
    }
    printf("greatest difference %g of what is allowed, %d samples, %d further contacts\n", greatest, told, further);
    return greatest <= 1.0f && told == SAMPLES ? 0 : 1;
}
#endif
