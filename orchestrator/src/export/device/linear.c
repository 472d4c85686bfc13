
ADD(add_wide, wide)

static wide seen[TAPS];

/* Adds channel after channel: its instants from the oldest on, of which so many in a row share a weight. */
static void add_spans(const layer *of, int oldest)
{
    for (int c = 0; c < of->in; c++) {
        const value *ring = of->ring + c * of->slots, *end = ring + of->slots, *x = ring + oldest;
        for (int tap = 0; tap < TAPS; tap++) {
            if (SPAN[tap] == 4 && x + 4 < end) {
                seen[tap] = (wide)x[0] + x[1] + x[2] + x[3];
                x += 4;
                continue;
            }
            seen[tap] = 0;
            for (int n = SPAN[tap]; n > 0; n--) {
                seen[tap] += *x;
                if (++x == end) x = ring;
            }
        }
        add_wide(of->out, TAPS, of->w + c * of->out * TAPS, seen);
    }
}
