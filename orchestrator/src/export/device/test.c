
#ifdef BRAIN_CLOCK
unsigned BRAIN_CLOCK(void); /* the time, for -DBRAIN_CLOCK=function */
static unsigned took, longest;
#endif

int main(void)
{
    float greatest = 0.0f, force[BRAIN_PANELS];
    int others = 0; //integers
    for (int s = 0; s < SAMPLES; s++) {
        int told = 0;
        brain_reset();
        for (int n = 0; n < 2 * INSTANTS && told < INSTANTS; n++) {
            const float *reading = READINGS + (n < INSTANTS ? s * INSTANTS + n : 0) * BRAIN_CHANNELS;
#ifdef BRAIN_CLOCK
            unsigned from = BRAIN_CLOCK();
#endif
            int some = n < INSTANTS ? brain_read(reading, force) : brain_end(force);
#ifdef BRAIN_CLOCK
            from = BRAIN_CLOCK() - from;
            took += some ? from : 0;
            longest = from > longest ? from : longest;
#endif
            if (!some) continue;
            for (int k = 0; k < BRAIN_PANELS; k++) {
                int at = (s * INSTANTS + told) * BRAIN_PANELS + k;
                float off = force[k] - FORCES[at];
                off = off < 0.0f ? -off : off;
                if (!(off <= greatest)) greatest = off;
                others += sums[k] != SUMS[at]; //integers
            }
            told++;
        }
        if (told < INSTANTS || brain_end(force)) {
            printf("sample %d: %d of %d instants told\n", s, told, INSTANTS);
            return 1;
        }
    }
    printf("greatest difference %g N, allowed %g N\n", greatest, BOUND);
    printf("sums that differ: %d of %d\n", others, SAMPLES * INSTANTS * BRAIN_PANELS); //integers
#ifdef BRAIN_CLOCK
    printf("ticks an answer: %u in the mean, %u at most\n", took / (SAMPLES * INSTANTS), longest);
#endif
    if (others) return 1; //integers
    return greatest <= BOUND ? 0 : 1;
}
#endif
