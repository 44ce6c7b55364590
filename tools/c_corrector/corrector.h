/* Kilter corrector: joint setpoints corrected by the calibration of one arm, in C99. See kilter_corrector.c.
 *
 * SPDX-License-Identifier: Apache-2.0 OR MIT OR GPL-2.0-or-later
 *
 * A program is what `kilter version export VERSION --format corrector` writes: one version of one arm. Load it once, then call
 * kc_correct for every setpoint, from one thread. Nothing is allocated and nothing is locked.
 * Angles rad, lengths m, times s.
 *
 * Compile without -ffast-math, and with -ffp-contract=off where the machine has FMA: then the answers are those of the
 * kernels bit for bit. GCC and clang are told so in the C file; another compiler has to be told by its own option.
 */
#ifndef KC_CORRECTOR_H
#define KC_CORRECTOR_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define KC_FORMAT 1u          /* of the program's header */
#define KC_LAYOUT @LAYOUT@  /* of its numbers: a program for another layout is refused */
#define KC_COLUMNS @COLUMNS@
#define KC_HEADER_BYTES 128
#define KC_MOST_JOINTS 16
#define KC_MOST_MOVES 64
#define KC_MOST_ROWS 1024
#define KC_MOST_ROUNDS 1000
#define KC_MOST_HANGING 3     /* rounds of loads where the arm hangs */

/* Verdict on a setpoint: the numbers of the stream. Only KC_OK leaves joints. */
enum {
    KC_OK = @OK@,
    KC_NOT_FINITE = @NOT_FINITE@,     /* a setpoint is not a number */
    KC_JOINT_LIMIT = @JOINT_LIMIT@,    /* wanted joints are outside the limits of the arm */
    KC_TOO_LARGE = @TOO_LARGE@,      /* the correction exceeds its limits */
    KC_RATE_LIMIT = @RATE_LIMIT@,     /* a joint is asked to move faster than it may */
    KC_NOT_LOADED = 20   /* no program was loaded */
};

/* How an answer was made: flags, together. */
enum {
    KC_DYNAMIC = @DYNAMIC@,     /* the loads include motion */
    KC_RAMPING = @RAMPING@,     /* the start, or a change of version, is still being ramped */
    KC_REVERSING = @REVERSING@,  /* clearance or backlash changes sides: softly, or at its rate */
    KC_DAMPED = @DAMPED@,     /* near a singular posture the correction is damped */
    KC_RESIDUAL = @RESIDUAL@,   /* the tool is left off by more than the program's bound: see left_m */
    KC_SATURATED = @SATURATED@,  /* the correction is held at its limit, and part of the error is left */
    KC_SLOWED = @SLOWED@,    /* the correction is held back by the bound on its rate or acceleration */
    KC_UNSURE = @UNSURE@     /* the version is less sure here than it says: see its report */
};

/* Why a program was not loaded. */
enum {
    KC_TRUNCATED = -1,
    KC_NOT_A_PROGRAM = -2,
    KC_NEWER_FORMAT = -3,
    KC_OTHER_LAYOUT = -4,
    KC_DAMAGED = -5,      /* its checksum is wrong */
    KC_IMPOSSIBLE = -6,   /* its numbers are those of no arm */
    KC_NO_MEMORY = -7,    /* the memory handed over is too small */
    KC_OTHER_ARM = -8     /* it is of another robot than the one before it */
};

typedef struct {
    int status;              /* KC_OK, or why there are no joints */
    unsigned flags;
    unsigned limit_mask;     /* bit i: joint i is concerned */
    int rounds;              /* of the search */
    double left_m[3];        /* what is left of the tool's error: actual minus wanted, axes of the wanted base */
    double left_rad;
    double left;             /* its length, m */
    double without_m[3];     /* the tool's error without the correction, predicted: actual minus wanted */
} kc_answer;

typedef struct {
    char version[41];        /* id of the version */
    char robot[65];
    uint64_t number;         /* that the stream's messages carry for it */
    int joints;
    /* private */
    int rows, moves;
    double (*memory)[KC_COLUMNS];
    double setpoint[3 * KC_MOST_JOINTS];
} kc_corrector;

/* How many doubles of memory a program needs; 0 when it is not one. */
size_t kc_memory_needed(const void *program, size_t bytes);

/* Load a program into the memory handed over, which the corrector uses until another program is loaded. `settled`: the
 * arm rests at the first setpoint, which gets the whole correction at once; else it is ramped in. Returns 0 or a
 * negative reason, which leaves the corrector as it was. */
int kc_load(kc_corrector *corrector, const void *program, size_t bytes, double *memory, size_t doubles,
                int settled);

/* Go on with another version of the same arm: the difference is ramped. The memory must not be that in use. */
int kc_change(kc_corrector *corrector, const void *program, size_t bytes, double *memory, size_t doubles);

/* Forget the past. */
void kc_restart(kc_corrector *corrector, int settled);

/* Correct one setpoint of a stream, `dt` s after the last one; qd and qdd are both given or both NULL. Writes
 * `corrected`, joints many, NaN unless the status is KC_OK. Returns the status. */
int kc_correct(kc_corrector *corrector, const double *q, const double *qd, const double *qdd, double dt,
                   double *corrected, kc_answer *answer);

/* Correct a setpoint that follows no other: no ramp, no rates, whole at once. `direction`: of the last motion of each
 * joint, -1, 0 or 1, or NULL. The stream's memory is not touched. The joints are written where the status is
 * KC_OK; elsewhere they are what could be reached, and nothing may move by them. */
int kc_correct_alone(kc_corrector *corrector, const double *q, const double *qd, const double *qdd,
                         const double *direction, double *corrected, kc_answer *answer);

/* What a status or a reason means, in a sentence. */
const char *kc_sentence(int code);

#ifdef __cplusplus
}
#endif
#endif
