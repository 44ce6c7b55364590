/* Messages of a Kilter stream for a controller in C99: encode a setpoint, decode its answer. See docs/reference/stream.md.
 * No allocation, no dependency, any byte order, any alignment. Angles in rad, prismatic joints in m.
 *
 * Every number is little-endian. A message begins with 32 bytes:
 *
 *   offset  bytes  type     field
 *        0      4  char[4]  magic, "KLT1"; "KLT2" when signed
 *        4      1  uint8    kind: 0 a setpoint or its answer (1 chunk, 2 trajectory: not in this file)
 *        5      1  uint8    joints n, 1 to 16; in an answer 0 unless the status is KILTER_OK
 *        6      2  uint16   flags
 *        8      8  uint64   seq, one more with every message; echoed
 *       16      8  uint64   t_send_ns, the controller's clock; echoed
 *       24      8  uint64   t_apply_ns, the same clock, 0 for at once; echoed
 *
 * To the corrector follow: 8 bytes version (uint64) with KILTER_VERSION, then n float64 q, n float64 qd with KILTER_QD,
 * n float64 qdd with KILTER_QDD. A plain setpoint of 6 joints has 80 bytes.
 *
 * In an answer follow 24 bytes, and n float64 corrected q only when the status is KILTER_OK (6 joints: 104 bytes):
 *
 *   offset  bytes  type     field
 *       32      8  uint64   version used
 *       40      4  uint32   epoch, grows with every activation
 *       44      2  uint16   status
 *       46      2  uint16   limit_mask, bit 0 is joint 1
 *       48      4  uint32   processing_ns
 *       52      4  int32    left_nm, how far the tool stays from where it should be with the joints answered, nm;
 *                            2147483647 for that and more, 0 unless the status is KILTER_OK (0 always: an old corrector)
 *
 * A signed message has the magic "KLT2" and 32 more bytes: session id and tag. Beyond the corrector's own machine no others are
 * taken. Ask the API for a session (POST /v1/robots/{robot}/stream/sessions), fill a kilter_session with its id and key, send
 * kilter_greet and give what comes back to kilter_challenged, until it returns 1. Then kilter_seal what kilter_encode wrote,
 * and kilter_open each answer before kilter_decode. When a signed setpoint is answered with KILTER_NO_SESSION, kilter_challenged
 * takes the new nonce; after a few cycles without any answer send kilter_greet again. seq grows with every setpoint of a session.
 *
 * What a controller must do: wait, up to its own deadline, for an answer that kilter_accept accepts. Anybody can publish
 * on the key of the answers, so begin seq at a random number, add a random offset to the clock of both times, draw new
 * random last 20 bits of t_send_ns for every setpoint, and always set t_apply_ns. In time and KILTER_OK: send q.
 * Otherwise send the wanted joints plus the last good difference for a few cycles; then fade that difference out, or
 * stop. After KILTER_STALE, KILTER_SEQ_BACK or KILTER_RATE_LIMIT, and after two KILTER_SEQ_GAP in a row, send the next
 * setpoint with KILTER_RESET | KILTER_SETTLED. Limit the change of the difference to what your arm can follow. */
#ifndef KILTER_FRAMES_H
#define KILTER_FRAMES_H

#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include "kilter_blake2s.h"

#define KILTER_MAX_JOINTS 16
#define KILTER_HEADER_BYTES 32
#define KILTER_VERDICT_BYTES 24
#define KILTER_TAG_BYTES 16
#define KILTER_TRAILER_BYTES 32
#define KILTER_SETPOINT_BYTES (KILTER_HEADER_BYTES + 8 + 8 * 3 * KILTER_MAX_JOINTS + KILTER_TRAILER_BYTES)

enum { KILTER_QD = 0x0001, KILTER_QDD = 0x0002, KILTER_VERSION = 0x0004, KILTER_RESET = 0x0008, KILTER_SETTLED = 0x0010 };
enum {
    KILTER_DYNAMIC = 0x0100, KILTER_RAMPING = 0x0200, KILTER_REVERSING = 0x0400, KILTER_DAMPED = 0x0800,
    KILTER_RESIDUAL = 0x1000, KILTER_SATURATED = 0x2000, KILTER_SLOWED = 0x4000, KILTER_UNSURE = 0x8000
};
enum {
    KILTER_OK, KILTER_STALE, KILTER_SEQ_GAP, KILTER_SEQ_BACK, KILTER_BAD_FRAME, KILTER_NOT_FINITE, KILTER_JOINT_LIMIT,
    KILTER_CORRECTION_TOO_LARGE, KILTER_RATE_LIMIT, KILTER_NO_VERSION, KILTER_VERSION_MISMATCH, KILTER_OVERLOAD,
    KILTER_NO_SESSION, KILTER_UNSIGNED, KILTER_SESSION_EXPIRED
};

typedef struct {
    uint64_t seq, t_send_ns, t_apply_ns, version;
    uint32_t epoch, processing_ns;
    int32_t left_nm;             /* never negative */
    uint16_t flags, status, limit_mask;
    uint8_t joints;              /* 0 unless the status is KILTER_OK */
    double q[KILTER_MAX_JOINTS]; /* written only when the status is KILTER_OK */
} kilter_answer;

static inline void kilter_put(uint8_t *at, uint64_t value, int bytes) {
    for (int i = 0; i < bytes; i++) at[i] = (uint8_t)(value >> (8 * i));
}

static inline uint64_t kilter_get(const uint8_t *at, int bytes) {
    uint64_t value = 0;
    for (int i = 0; i < bytes; i++) value |= (uint64_t)at[i] << (8 * i);
    return value;
}

static inline size_t kilter_put_doubles(uint8_t *at, const double *values, int count) {
    for (int i = 0; i < count; i++) {
        uint64_t bits;
        memcpy(&bits, &values[i], 8);
        kilter_put(at + 8 * i, bits, 8);
    }
    return (size_t)(8 * count);
}

/* Write one setpoint of n joints into out (KILTER_SETPOINT_BYTES are always enough) and return its length, 0 when n is
 * out of range. qd and qdd may be NULL; version 0 insists on none. flags: KILTER_RESET and KILTER_SETTLED. */
static inline size_t kilter_encode(uint8_t *out, const double *q, const double *qd, const double *qdd, int n,
                                   uint16_t flags, uint64_t seq, uint64_t t_send_ns, uint64_t t_apply_ns,
                                   uint64_t version) {
    size_t at = KILTER_HEADER_BYTES;
    if (n < 1 || n > KILTER_MAX_JOINTS || (qdd && !qd)) return 0;
    flags &= KILTER_RESET | KILTER_SETTLED;
    if (qd) flags |= KILTER_QD;
    if (qdd) flags |= KILTER_QDD;
    if (version) flags |= KILTER_VERSION;
    memcpy(out, "KLT1", 4);
    out[4] = 0;
    out[5] = (uint8_t)n;
    kilter_put(out + 6, flags, 2);
    kilter_put(out + 8, seq, 8);
    kilter_put(out + 16, t_send_ns, 8);
    kilter_put(out + 24, t_apply_ns, 8);
    if (version) {
        kilter_put(out + at, version, 8);
        at += 8;
    }
    at += kilter_put_doubles(out + at, q, n);
    if (qd) at += kilter_put_doubles(out + at, qd, n);
    if (qdd) at += kilter_put_doubles(out + at, qdd, n);
    return at;
}

/* Read an answer to a single setpoint. Returns 1 when the bytes are one, else 0. Numbers are there only when
 * answer->status is KILTER_OK; compare answer->seq with what was sent and answer->epoch with what was announced. */
static inline int kilter_decode(const uint8_t *data, size_t length, kilter_answer *answer) {
    const size_t head = KILTER_HEADER_BYTES + KILTER_VERDICT_BYTES;
    int joints;
    if (length < head || memcmp(data, "KLT1", 4) != 0 || data[4] != 0) return 0;
    joints = data[5];
    answer->status = (uint16_t)kilter_get(data + 44, 2);
    if (joints > KILTER_MAX_JOINTS || answer->status > KILTER_SESSION_EXPIRED) return 0;
    if (data[55] & 0x80) return 0; /* less than nothing cannot be left */
    if ((answer->status == KILTER_OK) != (joints > 0) || length != head + 8 * (size_t)joints) return 0;
    answer->joints = (uint8_t)joints;
    answer->flags = (uint16_t)kilter_get(data + 6, 2);
    answer->seq = kilter_get(data + 8, 8);
    answer->t_send_ns = kilter_get(data + 16, 8);
    answer->t_apply_ns = kilter_get(data + 24, 8);
    answer->version = kilter_get(data + 32, 8);
    answer->epoch = (uint32_t)kilter_get(data + 40, 4);
    answer->limit_mask = (uint16_t)kilter_get(data + 46, 2);
    answer->processing_ns = (uint32_t)kilter_get(data + 48, 4);
    answer->left_nm = (int32_t)kilter_get(data + 52, 4);
    for (int i = 0; i < joints; i++) {
        uint64_t bits = kilter_get(data + head + 8 * (size_t)i, 8);
        memcpy(&answer->q[i], &bits, 8);
    }
    return 1;
}

/* Whether an answer may be acted on: it echoes seq and both times of the setpoint just sent, exactly. Of those with numbers:
 * they are n, finite, and none is farther from the wanted q than largest[i] (rad or m); epoch and version are the announced
 * ones. A refusal that is the right echo is taken, too; look at answer->status. */
static inline int kilter_accept(const kilter_answer *answer, uint64_t seq, uint64_t t_send_ns, uint64_t t_apply_ns,
                                const double *wanted, const double *largest, int n, uint32_t epoch, uint64_t version) {
    if (answer->seq != seq || answer->t_send_ns != t_send_ns || answer->t_apply_ns != t_apply_ns) return 0;
    if (answer->status != KILTER_OK) return 1;
    if (answer->joints != n || answer->epoch != epoch || answer->version != version) return 0;
    for (int i = 0; i < n; i++) {
        double delta = answer->q[i] - wanted[i];
        if (!(delta <= largest[i] && delta >= -largest[i])) return 0; /* nor when it is not a number */
    }
    return 1;
}

typedef struct {
    uint8_t id[16], key[32]; /* of the API */
    uint8_t in_use[32];      /* made by kilter_challenged */
} kilter_session;

static inline void kilter_tag(uint8_t *tag, const uint8_t key[32], const char *use, const uint8_t *data, size_t length) {
    kilter_blake2s(tag, KILTER_TAG_BYTES, key, 32, use, data, length);
}

/* Whether the last 16 bytes are the tag of those before, compared in constant time. */
static inline int kilter_fits(const uint8_t key[32], const char *use, const uint8_t *data, size_t length) {
    uint8_t tag[KILTER_TAG_BYTES], differ = 0;
    kilter_tag(tag, key, use, data, length - KILTER_TAG_BYTES);
    for (int i = 0; i < KILTER_TAG_BYTES; i++) differ |= (uint8_t)(tag[i] ^ data[length - KILTER_TAG_BYTES + i]);
    return differ == 0;
}

static inline size_t kilter_signed(uint8_t *frame, size_t length, const kilter_session *session, const uint8_t *key,
                                   const char *use) {
    memcpy(frame, "KLT2", 4);
    memcpy(frame + length, session->id, 16);
    kilter_tag(frame + length + 16, key, use, frame, length + 16);
    return length + KILTER_TRAILER_BYTES;
}

/* Sign what kilter_encode wrote; there must be room for KILTER_TRAILER_BYTES more. Returns the new length. */
static inline size_t kilter_seal(uint8_t *frame, size_t length, const kilter_session *session) {
    return kilter_signed(frame, length, session, session->in_use, "KLT2in");
}

/* Write the message that asks for the corrector's nonce; seq and t_send_ns at random. Returns its length. */
static inline size_t kilter_greet(uint8_t *out, const kilter_session *session, uint64_t seq, uint64_t t_send_ns) {
    memset(out, 0, KILTER_HEADER_BYTES);
    out[4] = 3;
    kilter_put(out + 8, seq, 8);
    kilter_put(out + 16, t_send_ns, 8);
    return kilter_signed(out, KILTER_HEADER_BYTES, session, session->key, "KLT2helo");
}

/* Take the nonce from the answer to a greeting or a setpoint with this seq and t_send_ns. Returns 1 when it is one. */
static inline int kilter_challenged(const uint8_t *data, size_t length, kilter_session *session, uint64_t seq,
                                    uint64_t t_send_ns) {
    const size_t head = KILTER_HEADER_BYTES + KILTER_VERDICT_BYTES;
    if (length != head + 16 + KILTER_TRAILER_BYTES || memcmp(data, "KLT2", 4) != 0) return 0;
    if (memcmp(data + length - KILTER_TRAILER_BYTES, session->id, 16) != 0) return 0;
    if (kilter_get(data + 8, 8) != seq || kilter_get(data + 16, 8) != t_send_ns) return 0;
    if (kilter_get(data + 44, 2) != KILTER_NO_SESSION || !kilter_fits(session->key, "KLT2chal", data, length)) return 0;
    kilter_blake2s(session->in_use, 32, session->key, 32, "KLT2work", data + head, 16);
    return 1;
}

/* Check the tag of an answer and make it a plain one for kilter_decode. Returns its length, 0 when it is not signed so. */
static inline size_t kilter_open(uint8_t *data, size_t length, const kilter_session *session) {
    if (length < KILTER_HEADER_BYTES + KILTER_TRAILER_BYTES || memcmp(data, "KLT2", 4) != 0) return 0;
    if (memcmp(data + length - KILTER_TRAILER_BYTES, session->id, 16) != 0) return 0;
    if (!kilter_fits(session->in_use, "KLT2out", data, length)) return 0;
    memcpy(data, "KLT1", 4);
    return length - KILTER_TRAILER_BYTES;
}

#endif
