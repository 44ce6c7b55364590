/* For libFuzzer: `tools.lab fuzz-c`. An input is a program, with whatever checksum, and behind it what a controller does with it:
 * a byte says what, and numbers follow. Where its last byte is odd the checksum is set right first, as a hostile hand could:
 * then the numbers of the program are tried, else what stands before them. */
#include "kilter_corrector.h"
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

enum { CRC_AT = 28, ROWS_AT = 16, MOST_CALLS = 40, DOUBLES = (KC_MOST_ROWS + 256) * KC_COLUMNS };

static uint32_t crc_of(const unsigned char *bytes, size_t count)
{
    uint32_t crc = ~0u;
    for (size_t i = 0; i < count; i++) {
        crc ^= bytes[i];
        for (int bit = 0; bit < 8; bit++)
            crc = crc & 1u ? crc >> 1 ^ 0xedb88320u : crc >> 1;
    }
    return ~crc;
}

/* Numbers of the input, one after another; zero behind its end. */
typedef struct { const unsigned char *at; size_t left; } rest_of_input;

static double number(rest_of_input *rest)
{
    double value = 0.0;
    if (rest->left >= 2 && rest->at[0] < 250) { /* most are those of an arm, or a mutation would hardly ever make one */
        value = ((int)rest->at[0] * 256 + rest->at[1] - 32000) / 10000.0;
        rest->at += 2, rest->left -= 2;
    } else if (rest->left >= 9) {
        memcpy(&value, rest->at + 1, 8);
        rest->at += 9, rest->left -= 9;
    }
    return value;
}

static void drive(kc_corrector *c, rest_of_input rest, const unsigned char *program, size_t bytes, double *memories[2])
{
    double q[3][KC_MOST_JOINTS] = {{0}}, direction[KC_MOST_JOINTS], out[KC_MOST_JOINTS], dt = 0.01;
    kc_answer answer;
    int used = 0;
    for (int k = 0; k < MOST_CALLS; k++) {
        const int what = rest.left ? *rest.at : k;
        if (rest.left)
            rest.at++, rest.left--;
        const int vectors = what & 1 ? 3 : 1;
        for (int v = 0; v < vectors; v++)
            for (int i = 0; i < c->joints; i++)
                q[v][i] = rest.left ? number(&rest) : q[v][i] + 0.01;
        if (what & 2)
            dt = number(&rest);
        const double *qd = vectors == 3 ? q[1] : NULL, *qdd = vectors == 3 && !(what & 4) ? q[2] : NULL;
        switch (what >> 3 & 7) {
        case 5:
            kc_restart(c, what & 4);
            break;
        case 6:
            if (kc_change(c, program, bytes, memories[1 - used], DOUBLES) == 0)
                used = 1 - used;
            break;
        case 7:
            for (int i = 0; i < c->joints; i++)
                direction[i] = number(&rest);
            kc_correct_alone(c, q[0], qd, qdd, direction, out, &answer);
            break;
        default: {
            const int status = kc_correct(c, q[0], qd, qdd, dt, out, &answer);
            for (int i = 0; i < c->joints; i++)
                if (status == KC_OK ? !isfinite(out[i]) : !isnan(out[i]))
                    abort(); /* what the header promises of the joints */
            if (answer.rounds < 0 || answer.rounds > KC_MOST_ROUNDS)
                abort();
        }
        }
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    static double *memories[2];
    for (int i = 0; i < 2 && !memories[i]; i++)
        memories[i] = malloc(DOUBLES * sizeof(double));
    size_t whole = size;
    if (size >= KC_HEADER_BYTES) {
        const size_t rows = data[ROWS_AT] | (size_t)data[ROWS_AT + 1] << 8;
        const size_t stated = KC_HEADER_BYTES + rows * KC_COLUMNS * 8;
        whole = stated < size ? stated : size;
    }
    unsigned char *program = malloc(whole ? whole : 1); /* as long as it is, so that a read behind its end shows */
    memcpy(program, data, whole);
    if (whole >= KC_HEADER_BYTES && data[size - 1] & 1) {
        memset(program + CRC_AT, 0, 4);
        const uint32_t crc = crc_of(program, whole);
        for (int i = 0; i < 4; i++)
            program[CRC_AT + i] = (unsigned char)(crc >> 8 * i);
    }
    kc_corrector c;
    memset(&c, 0xa5, sizeof c);
    const size_t needed = kc_memory_needed(program, whole);
    double *exact = malloc(needed ? needed * sizeof(double) : 1);
    const int fault = kc_load(&c, program, whole, exact, needed, (int)(size & 1));
    if ((fault == 0) != (needed > 0))
        abort();
    if (fault == 0) {
        const rest_of_input rest = {data + whole, size - whole};
        drive(&c, rest, program, whole, memories);
    }
    free(exact);
    free(program);
    return 0;
}
