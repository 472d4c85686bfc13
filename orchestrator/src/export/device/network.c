
ADD(add_values, value)

/* Adds the taps of a layer, from its oldest instant on. */
static void add_taps(const layer *of, int at)
{
    for (int tap = 0; tap < of->taps; tap++) {
        add_values(of->out, of->in, of->w + tap * of->in * of->out, of->ring + at * of->in);
        at += of->dilation;
        if (at >= of->slots) at -= of->slots;
    }
}
