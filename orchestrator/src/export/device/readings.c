
/* Takes one more input, zero if there is none, and makes the sums once there are enough. */
static int push(int l, const value *input)
{
    const layer *of = &LAYER[l];
    newest[l] = newest[l] + 1 < of->slots ? newest[l] + 1 : 0;
    for (int c = 0; c < of->in; c++) of->ring[PLACE(l, newest[l], c)] = input ? input[c] : 0;
    if (known[l] < of->after) {
        known[l]++;
        return 0;
    }
    for (int o = 0; o < of->out; o++) sums[o] = of->b[o];
    int oldest = newest[l] + 1 < of->slots ? newest[l] + 1 : 0;
#if LINEAR
    if (l == 0) {
        add_spans(of, oldest);
        return 1;
    }
#endif
#if LAYERS > LINEAR
    add_taps(of, oldest);
#endif
    return 1;
}

#if LAYERS > 1
/* What a layer hands on; of a linear brain what it has read at the instant, and then what it says. */
static void hand_on(int l)
{
    const layer *of = &LAYER[l];
    int c = 0;
#if LINEAR
    if (l == 0) {
        int at = newest[0] < of->after ? newest[0] - of->after + of->slots : newest[0] - of->after;
        for (; c < of->in; c++) made[c] = of->ring[PLACE(0, at, c)];
    }
#endif
    for (int o = 0; o < of->out; o++) made[c + o] = handed(of, o, LINEAR && l == 0);
}
#endif

static int through(int l, const value *input, float *force)
{
#if LAYERS > 1
    for (; l + 1 < LAYERS; l++, input = made) {
        if (!push(l, input)) return 0;
        hand_on(l);
    }
#endif
    if (!push(l, input)) return 0;
    tell(force);
    return 1;
}

int brain_read(const float *reading, float *force)
{
    value input[BRAIN_CHANNELS];
    take(reading, input);
    return through(0, input, force);
}

int brain_end(float *force)
{
    for (int l = 0; l < LAYERS; l++)
        while (ended[l] < LAYER[l].after) {
            ended[l]++;
            if (through(l, 0, force)) return 1;
        }
    return 0;
}
