
/* Takes one more input, zero if there is none, and makes the sums once there are enough. */
static int push(int l, const value *input)
{
    const layer *of = &LAYER[l];
    newest[l] = newest[l] + 1 < of->slots ? newest[l] + 1 : 0;
    for (int c = 0; c < of->in; c++) of->ring[PLACE(newest[l], c, of)] = input ? input[c] : 0;
    if (known[l] < of->after) {
        known[l]++;
        return 0;
    }
    for (int o = 0; o < of->out; o++) sums[o] = of->b[o];
    add_taps(of, newest[l] + 1 < of->slots ? newest[l] + 1 : 0);
    return 1;
}

static int through(int l, const value *input, float *force)
{
#if LAYERS > 1
    for (; l + 1 < LAYERS; l++, input = made) {
        if (!push(l, input)) return 0;
        hand_on(&LAYER[l]);
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
