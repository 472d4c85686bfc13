/* Starts a program on a Cortex-M4 in QEMU (machine mps2-an386) and counts its instructions: SysTick runs at 25 MHz, and with
   `-icount shift=3` an instruction takes 8 ns, so that a tick is 5 instructions. For the calls see docs/reference/exports.md. */
#include <stdint.h>

extern void _start(void);

static volatile uint32_t *const SYSTICK = (uint32_t *)0xE000E010, *const CPACR = (uint32_t *)0xE000ED88;

static void reset(void)
{
    *CPACR |= 0xFu << 20; /* the float unit */
    SYSTICK[1] = 0xFFFFFF;
    SYSTICK[2] = 0;
    SYSTICK[0] = 5; /* on, at the clock of the processor */
    _start();
}

static void stop(void)
{
    for (;;) {}
}

/* The end of the memory, and where it begins; what goes wrong after that stops. */
__attribute__((section(".vectors"), used)) static void (*const VECTORS[])(void) = {
    (void (*)(void))0x20400000, reset, stop, stop, stop, stop, stop};

/* Instructions so far; to be called every 80 million. */
unsigned instructions(void)
{
    static uint32_t last, all;
    uint32_t now = 0xFFFFFF - SYSTICK[2];
    all += (now - last) & 0xFFFFFF;
    last = now;
    return 5 * all;
}
