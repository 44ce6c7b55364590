/* Speaks frames over standard input and output: a line "q ..." prints the setpoint to send in hexadecimal, a line
 * "a <hex>" what an answer says. Build: cc -std=c99 -Wall -Wextra -o controller controller.c */
#include <stdio.h>
#include <stdlib.h>

#include "kilter_frames.h"

static void setpoint(char *numbers, uint64_t seq) {
    uint8_t frame[KILTER_SETPOINT_BYTES];
    double q[KILTER_MAX_JOINTS];
    int n = 0;
    char *end = numbers;
    for (double value = strtod(numbers, &end); end != numbers && n < KILTER_MAX_JOINTS; value = strtod(numbers, &end)) {
        q[n++] = value;
        numbers = end;
    }
    size_t length = kilter_encode(frame, q, NULL, NULL, n, 0, seq, 100, 200, 0);
    for (size_t i = 0; i < length; i++) printf("%02x", frame[i]);
    printf("\n");
}

static void answer(const char *hex) {
    uint8_t data[1024];
    size_t length = 0;
    unsigned byte;
    kilter_answer said;
    while (length < sizeof data && sscanf(hex + 2 * length, "%2x", &byte) == 1) data[length++] = (uint8_t)byte;
    if (!kilter_decode(data, length, &said)) {
        printf("not an answer\n");
        return;
    }
    printf("seq %llu status %u epoch %u version %016llx mask %u", (unsigned long long)said.seq, said.status,
           (unsigned)said.epoch, (unsigned long long)said.version, said.limit_mask);
    for (int i = 0; i < said.joints; i++) printf(" %.17g", said.q[i]);
    printf("\n");
}

int main(void) {
    char line[4096];
    for (uint64_t seq = 7; fgets(line, sizeof line, stdin);) {
        if (line[0] == 'q') setpoint(line + 1, seq++);
        if (line[0] == 'a') answer(line + 2);
    }
    return 0;
}
