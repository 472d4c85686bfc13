
static int newest[LAYERS], known[LAYERS], ended[LAYERS];
static sum sums[WIDEST];
#if LAYERS > 1
static value made[WIDEST]; /* what is handed on from layer to layer */
#endif

void brain_reset(void)
{
    for (int l = 0; l < LAYERS; l++) {
        newest[l] = known[l] = ended[l] = 0;
        for (int i = 0; i < LAYER[l].slots * LAYER[l].in; i++) LAYER[l].ring[i] = 0;
    }
}

/* Where a layer's ring has an instant's input: of a linear brain channel after channel, else instant after instant. */
#if LINEAR
#define PLACE(l, at, c) ((l) ? (at) * LAYER[l].in + (c) : (c) * LAYER[l].slots + (at))
#else
#define PLACE(l, at, c) ((at) * LAYER[l].in + (c))
#endif

/* A function that adds to each sum n inputs times its own weights; by fours, which takes two thirds of the time. */
#define ADD(add, row) \
    static void add(int out, int n, const weight *w, const row *x) \
    { \
        for (int o = 0; o < out; o++, w += n) { \
            sum y = sums[o]; \
            int i = 0; \
            for (; i + 4 <= n; i += 4) { \
                y += (sum)w[i] * x[i]; \
                y += (sum)w[i + 1] * x[i + 1]; \
                y += (sum)w[i + 2] * x[i + 2]; \
                y += (sum)w[i + 3] * x[i + 3]; \
            } \
            for (; i < n; i++) y += (sum)w[i] * x[i]; \
            sums[o] = y; \
        } \
    }
