/* Reads and writes messages of the stream on standard input and output: a line "q ..." prints the setpoint to send in
 * hexadecimal, a line "a <hex>" what an answer says, a line "c <epoch> <version> <hex>" whether an answer to the last
 * setpoint may be used. "k <id> <key>" begins a signed session and prints the greeting, "n <hex>" takes the corrector's nonce;
 * from there on setpoints and answers are signed. "t" says whether BLAKE2s passes its self-test. A real controller begins seq and clock at random, as kilter_frames.h says.
 * Build: cc -std=c99 -Wall -Wextra -o controller controller.c */
#include <stdio.h>
#include <stdlib.h>

#include "kilter_frames.h"

static double q[KILTER_MAX_JOINTS]; /* the last setpoint */
static int n;
static kilter_session session;
static int signs;

static void print(const uint8_t *data, size_t length) {
    for (size_t i = 0; i < length; i++) printf("%02x", data[i]);
    printf("\n");
}

static void setpoint(char *numbers, uint64_t seq) {
    uint8_t frame[KILTER_SETPOINT_BYTES];
    char *end = numbers;
    n = 0;
    for (double value = strtod(numbers, &end); end != numbers && n < KILTER_MAX_JOINTS; value = strtod(numbers, &end)) {
        q[n++] = value;
        numbers = end;
    }
    size_t length = kilter_encode(frame, q, NULL, NULL, n, 0, seq, 100, 200, 0);
    if (signs) length = kilter_seal(frame, length, &session);
    print(frame, length);
}

static size_t bytes_of(const char *hex, uint8_t *data, size_t most) {
    size_t length = 0;
    unsigned byte;
    while (length < most && sscanf(hex + 2 * length, "%2x", &byte) == 1) data[length++] = (uint8_t)byte;
    return length;
}

static size_t opened(const char *hex, uint8_t *data, size_t most) {
    size_t length = bytes_of(hex, data, most);
    return signs ? kilter_open(data, length, &session) : length;
}

static void greet(const char *hex) {
    uint8_t frame[KILTER_HEADER_BYTES + KILTER_TRAILER_BYTES];
    bytes_of(hex, session.id, sizeof session.id);
    bytes_of(hex + 33, session.key, sizeof session.key);
    print(frame, kilter_greet(frame, &session, 5, 6));
}

static void nonce(const char *hex) {
    uint8_t data[1024];
    signs = kilter_challenged(data, bytes_of(hex, data, sizeof data), &session, 5, 6);
    printf("%s\n", signs ? "signs" : "not a nonce");
}

static void answer(const char *hex) {
    uint8_t data[1024];
    kilter_answer said;
    if (!kilter_decode(data, opened(hex, data, sizeof data), &said)) {
        printf("not an answer\n");
        return;
    }
    printf("seq %llu status %u epoch %u version %016llx mask %u left %ld", (unsigned long long)said.seq, said.status,
           (unsigned)said.epoch, (unsigned long long)said.version, said.limit_mask, (long)said.left_nm);
    for (int i = 0; i < said.joints; i++) printf(" %.17g", said.q[i]);
    printf("\n");
}

static void check(const char *line, uint64_t seq) {
    uint8_t data[1024];
    double largest[KILTER_MAX_JOINTS];
    kilter_answer said;
    unsigned epoch;
    unsigned long long version;
    int at = 0;
    for (int i = 0; i < KILTER_MAX_JOINTS; i++) largest[i] = 0.0174533; /* 1 deg */
    if (sscanf(line, "%u %llx %n", &epoch, &version, &at) != 2) return;
    int good = kilter_decode(data, opened(line + at, data, sizeof data), &said) &&
               kilter_accept(&said, seq, 100, 200, q, largest, n, epoch, version);
    printf("%s\n", good ? "accepted" : "dropped");
}

int main(void) {
    char line[4096];
    for (uint64_t seq = 7; fgets(line, sizeof line, stdin);) {
        if (line[0] == 't') printf("%s\n", kilter_blake2s_good() ? "good" : "wrong");
        if (line[0] == 'k') greet(line + 2);
        if (line[0] == 'n') nonce(line + 2);
        if (line[0] == 'q') setpoint(line + 1, seq++);
        if (line[0] == 'a') answer(line + 2);
        if (line[0] == 'c') check(line + 2, seq - 1);
    }
    return 0;
}
