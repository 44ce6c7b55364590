/* The corrector on a Cortex-M7 without an operating system, as QEMU's mps2-an500 has it: start, one stream, the numbers.
 *
 * `program` and `wanted` come from the test. Joints are printed as the bits of their doubles, in hexadecimal, so that
 * nothing is rounded on the way; then the stack that was used, in bytes.
 */
#include "kilter_corrector.h"
#include "data.h"

extern char stack_top[], stack_end[], data_from[], data_to[], data_to_end[], bss[], bss_end[];

static double memory[(KC_MOST_ROWS + 256) * KC_COLUMNS];
static kc_corrector corrector;

static int ask_host(int what, const void *about)
{
    register int r0 __asm__("r0") = what;
    register const void *r1 __asm__("r1") = about;
    __asm__ volatile("bkpt 0xab" : "+r"(r0) : "r"(r1) : "memory");
    return r0;
}

static void print(const char *text) { ask_host(0x04, text); }

static void print_bits(uint64_t bits, char end)
{
    char text[18];
    for (int i = 0; i < 16; i++) text[i] = "0123456789abcdef"[bits >> (60 - 4 * i) & 15];
    text[16] = end;
    text[17] = 0;
    print(text);
}

static void leave(int code)
{
    const int block[2] = {0x20026, code};
    ask_host(0x20, block);
    for (;;) { }
}

static void correct_all(void)
{
    double out[JOINTS];
    kc_answer answer;
    for (int k = 0; k < COUNT; k++) {
        int status = kc_correct(&corrector, wanted[k], 0, 0, CYCLE_S, out, &answer);
        print_bits((uint64_t)status << 32 | answer.flags, ' ');
        for (int i = 0; i < JOINTS; i++) {
            union { double number; uint64_t bits; } one = {out[i]};
            print_bits(one.bits, i + 1 < JOINTS ? ' ' : '\n');
        }
    }
}

__attribute__((noinline)) static void run(void) /* starts when the unit for floating point is on */
{
    char *here;
    __asm__ volatile("mov %0, sp" : "=r"(here));
    for (volatile char *p = stack_end; p < here - 256; p++) *p = 0x5a;
    int code = kc_load(&corrector, program, sizeof program, memory, sizeof memory / sizeof *memory, 0);
    if (code) {
        print(kc_sentence(code));
        leave(1);
    }
    correct_all();
    const char *deepest = stack_end;
    while (*deepest == 0x5a) deepest++;
    print_bits((uint64_t)(here - deepest), '\n');
    leave(0);
}

void start(void)
{
    *(volatile uint32_t *)0xe000ed88 |= 0xfu << 20; /* the unit for floating point is off after reset */
    __asm__ volatile("dsb\n isb");
    for (char *to = data_to, *from = data_from; to < data_to_end;) *to++ = *from++;
    for (char *p = bss; p < bss_end; p++) *p = 0;
    run();
}

static void stopped(void) { print("a fault of the processor\n"); leave(2); }

__attribute__((section(".vectors"), used)) static void *const vectors[] = {
    stack_top, (void *)start, (void *)stopped, (void *)stopped, (void *)stopped, (void *)stopped, (void *)stopped,
};
