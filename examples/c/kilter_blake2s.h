/* BLAKE2s with key and personalisation (RFC 7693), for messages of up to 4 GB in one call. No allocation, C99, any byte order.
 * Written from the text of the RFC. Public domain (CC0 1.0): use it as you like.
 * kilter_blake2s_good() computes the RFC's self-test and returns 1 when this compiler got it right. */
#ifndef KILTER_BLAKE2S_H
#define KILTER_BLAKE2S_H

#include <stddef.h>
#include <stdint.h>
#include <string.h>

static inline uint32_t kilter_load32(const uint8_t *at) {
    return (uint32_t)at[0] | (uint32_t)at[1] << 8 | (uint32_t)at[2] << 16 | (uint32_t)at[3] << 24;
}

static inline uint32_t kilter_rotate(uint32_t x, int n) { return x >> n | x << (32 - n); }

static inline void kilter_blake2s_mix(uint32_t *v, int a, int b, int c, int d, uint32_t x, uint32_t y) {
    v[a] += v[b] + x;
    v[d] = kilter_rotate(v[d] ^ v[a], 16);
    v[c] += v[d];
    v[b] = kilter_rotate(v[b] ^ v[c], 12);
    v[a] += v[b] + y;
    v[d] = kilter_rotate(v[d] ^ v[a], 8);
    v[c] += v[d];
    v[b] = kilter_rotate(v[b] ^ v[c], 7);
}

static const uint32_t kilter_blake2s_iv[8] = {0x6A09E667u, 0xBB67AE85u, 0x3C6EF372u, 0xA54FF53Au,
                                              0x510E527Fu, 0x9B05688Cu, 0x1F83D9ABu, 0x5BE0CD19u};

static inline void kilter_blake2s_block(uint32_t h[8], const uint8_t block[64], uint32_t count, int last) {
    static const uint8_t order[10][16] = {
        {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15}, {14, 10, 4, 8, 9, 15, 13, 6, 1, 12, 0, 2, 11, 7, 5, 3},
        {11, 8, 12, 0, 5, 2, 15, 13, 10, 14, 3, 6, 7, 1, 9, 4}, {7, 9, 3, 1, 13, 12, 11, 14, 2, 6, 5, 10, 4, 0, 15, 8},
        {9, 0, 5, 7, 2, 4, 10, 15, 14, 1, 11, 12, 6, 8, 3, 13}, {2, 12, 6, 10, 0, 11, 8, 3, 4, 13, 7, 5, 15, 14, 1, 9},
        {12, 5, 1, 15, 14, 13, 4, 10, 0, 7, 6, 3, 9, 2, 8, 11}, {13, 11, 7, 14, 12, 1, 3, 9, 5, 0, 15, 4, 8, 6, 2, 10},
        {6, 15, 14, 9, 11, 3, 0, 8, 12, 2, 13, 7, 1, 4, 10, 5}, {10, 2, 8, 4, 7, 6, 1, 5, 15, 11, 9, 14, 3, 12, 13, 0}};
    uint32_t v[16], m[16];
    for (int i = 0; i < 16; i++) m[i] = kilter_load32(block + 4 * i);
    for (int i = 0; i < 8; i++) {
        v[i] = h[i];
        v[i + 8] = kilter_blake2s_iv[i];
    }
    v[12] ^= count;
    if (last) v[14] = ~v[14];
    for (int round = 0; round < 10; round++) {
        const uint8_t *s = order[round];
        for (int i = 0; i < 4; i++)
            kilter_blake2s_mix(v, i, 4 + i, 8 + i, 12 + i, m[s[2 * i]], m[s[2 * i + 1]]);
        for (int i = 0; i < 4; i++)
            kilter_blake2s_mix(v, i, 4 + (i + 1) % 4, 8 + (i + 2) % 4, 12 + (i + 3) % 4, m[s[8 + 2 * i]], m[s[9 + 2 * i]]);
    }
    for (int i = 0; i < 8; i++) h[i] ^= v[i] ^ v[i + 8];
}

/* Hash of n bytes into out (out_bytes, at most 32), with a key of key_bytes (0 to 32) and up to 8 characters of use. */
static inline void kilter_blake2s(uint8_t *out, size_t out_bytes, const uint8_t *key, size_t key_bytes, const char *use,
                                  const uint8_t *data, size_t n) {
    uint8_t block[64] = {0}, person[8] = {0};
    uint32_t h[8], count = 0;
    for (int i = 0; i < 8 && use[i]; i++) person[i] = (uint8_t)use[i];
    memcpy(h, kilter_blake2s_iv, sizeof h);
    h[0] ^= 0x01010000u ^ (uint32_t)key_bytes << 8 ^ (uint32_t)out_bytes;
    h[6] ^= kilter_load32(person);
    h[7] ^= kilter_load32(person + 4);
    if (key_bytes) {
        memcpy(block, key, key_bytes);
        count = 64;
        kilter_blake2s_block(h, block, count, n == 0);
    }
    if (n || !key_bytes) {
        do {
            size_t part = n < 64 ? n : 64;
            memset(block, 0, sizeof block);
            if (part) memcpy(block, data, part);
            data += part;
            n -= part;
            count += (uint32_t)part;
            kilter_blake2s_block(h, block, count, n == 0);
        } while (n);
    }
    for (size_t i = 0; i < out_bytes; i++) out[i] = (uint8_t)(h[i / 4] >> (8 * (i % 4)));
}

static inline void kilter_blake2s_sequence(uint8_t *out, size_t length, uint32_t seed) {
    uint32_t a = 0xDEAD4BADu * seed, b = 1;
    for (size_t i = 0; i < length; i++) {
        uint32_t t = a + b;
        a = b;
        b = t;
        out[i] = (uint8_t)(t >> 24);
    }
}

static inline int kilter_blake2s_good(void) {
    static const uint8_t expected[32] = {0x6A, 0x41, 0x1F, 0x08, 0xCE, 0x25, 0xAD, 0xCD, 0xFB, 0x02, 0xAB,
                                         0xA6, 0x41, 0x45, 0x1C, 0xEC, 0x53, 0xC5, 0x98, 0xB2, 0x4F, 0x4F,
                                         0xC7, 0x87, 0xFB, 0xDC, 0x88, 0x79, 0x7F, 0x4C, 0x1D, 0xFE};
    static const size_t sizes[4] = {16, 20, 28, 32}, lengths[6] = {0, 3, 64, 65, 255, 1024};
    uint8_t data[1024], key[32], one[32], all[4 * 6 * 2 * 32], sum[32];
    size_t at = 0;
    for (int i = 0; i < 4; i++)
        for (int j = 0; j < 6; j++) {
            kilter_blake2s_sequence(data, lengths[j], (uint32_t)lengths[j]);
            kilter_blake2s(one, sizes[i], NULL, 0, "", data, lengths[j]);
            memcpy(all + at, one, sizes[i]);
            at += sizes[i];
            kilter_blake2s_sequence(key, sizes[i], (uint32_t)sizes[i]);
            kilter_blake2s(one, sizes[i], key, sizes[i], "", data, lengths[j]);
            memcpy(all + at, one, sizes[i]);
            at += sizes[i];
        }
    kilter_blake2s(sum, 32, NULL, 0, "", all, at);
    return memcmp(sum, expected, 32) == 0;
}

#endif
