/* Kilter corrector: joint setpoints corrected by the calibration of one arm, in C99.
 *
 * SPDX-License-Identifier: Apache-2.0 OR MIT OR GPL-2.0-or-later
 * Taken under whichever of the three suits: it may go into GPL programs (LinuxCNC) and into closed controllers alike.
 *
 * Translated from the kernels of kilter_core by `python -m tools.c_corrector`; change those, not this file. It
 * allocates nothing, needs the headers of C99 and the library of math.h, and every loop is bounded by the arm's joints or by the rounds
 * that the program states. Angles rad, lengths m, masses kg, times s.
 */
#include "kilter_corrector.h"

/* A product and a sum rounded once, as machines with FMA do, are other numbers than those of the kernels. Compilers that
 * do not read this need -ffp-contract=off. */
#if defined(__clang__)
#pragma STDC FP_CONTRACT OFF
#elif defined(__GNUC__)
#pragma GCC optimize("fp-contract=off")
#elif defined(_MSC_VER)
#pragma fp_contract(off)
#endif

/* Around a function whose sums GCC 12 rounds together with products even so, where it vectorizes the pair of them. */
#if defined(__GNUC__) && !defined(__clang__)
#define SCALAR _Pragma("GCC push_options") _Pragma("GCC optimize(\"no-tree-slp-vectorize\")")
#define SCALAR_END _Pragma("GCC pop_options")
#else
#define SCALAR
#define SCALAR_END
#endif

#include <math.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

typedef double (*matrix)[KC_COLUMNS];
typedef struct { matrix at; int count; } rows;
typedef struct { double at[2]; } tuple2;
typedef struct { double at[3]; } tuple3;
typedef struct { double at[6]; } tuple6;
typedef struct { double at[12]; } tuple12;

static double larger(double a, double b) { return b > a ? b : a; }
static double smaller(double a, double b) { return b < a ? b : a; }
static double squared(double a) { return a * a; }

/* Places in the memory, and flags. */
enum {
    COLUMNS = 48, INFO = 12, REMOVED = 4, LEFT = 8, LEFT_TURN = 11, NOMINAL = 0, IDENTIFIED = 12, KIND = 24, JOINT = 25,
    RATIO = 26, PRIMARY = 27, MASS = 28, COM = 29, INERTIA = 32, CARRIED = 38, LOWER = 0, UPPER = 1, DQ = 2, XI = 3,
    TILT = 9, TILT_SOFT = 10, TILT_SHARE = 11, PLAY = 12, PLAY_SOFT = 13, REVERSAL = 14, COMPLIANCE = 15, RATE = 16,
    LARGEST = 17, SPEED = 18, RADIAL = 19, TWISTED = 20, HARDENING = 21, SIDED = 22, CHANGE = 23, SPURT = 24, FREE = 27,
    TILT_OWN = 25, PLAY_OWN = 26, CURVED = 0, SHAPE = 1, DRIVER = 2, AMPLITUDE_A = 3, AMPLITUDE_B = 4, FACTOR = 5,
    EXTRA = 6, POWERS = 8, HIGHEST = 20, MOVED = 21, FROM = 22, TO = 23, FADE = 24, MEAN = 25, BENDING = 0,
    BENDING_JOINT = 36, BENDING_LINK = 37, POWER = 40, ROOTED = 41, WAY = 42, OF_AXIS = 43, BASE_FRAME = 0,
    FIRST_MOVE = 12, MOUNT_X = 24, MOUNT_Y = 25, FIXED_MOMENT_X = 26, FIXED_MOMENT_Y = 27, GRAVITY = 0, ROWS = 3,
    WEIGHT = 10, ITERATIONS = 16, STEP = 17, SINGULAR = 18, FARTHEST = 19, RAMP = 20, FILTER = 21, HYSTERESIS = 22,
    LOADED = 23, REACHED = 24, N = 25, M = 26, WEAK = 27, CURVES = 28, BENDINGS = 29, MOUNT = 30, LOAD_CHAIN = 31,
    FIRST = 32, LEVERAGE = 33, TURNED = 34, SATURATES = 35, ROUNDS = 36, HANGING = 37, HANGING_SIDED = 38,
    DOUBT_AT = 39, DOUBTS = 40, LOWEST_OF_BOX = 0, HIGHEST_OF_BOX = 24, LINE = 12, SINE = 18, COSINE = 19, LOAD = 20,
    ON_BASE = 26, BEHIND_TWIST = 28, WANTED = 0, COMMAND = 1, SHIFT = 2, TILT_A = 3, TILT_B = 4, SIDE = 5, MOMENT = 6,
    SPEED_NOW = 9, ACCEL_NOW = 10, SIGN = 11, COLUMN = 12, REVERSED_AT_NEW = 18, SMOOTH_NEW = 19, SMOOTH_SPEED_NEW = 20,
    GUESSED = 21, TWIST = 22, ROOT = 28, END = 34, STEPPED = 40, RAMPED = 41, TOTAL = 42, NEXT = 43, WISH = 45,
    KEPT = 45, ERROR = 6, MULTIPLIER = 7, RIGHT = 8, MATRIX = 9, ADDED = 15, LAST_A = 0, LAST_B = 1, LAST_SIDE = 2,
    LAST_Q = 3, REVERSED_AT = 4, LAST_SIGN = 5, OFFSET = 6, LAST_DELTA = 7, SMOOTH = 8, SMOOTH_SPEED = 9, GUESS = 10,
    SLOPE = 11, VELOCITY = 12, TARGET = 13, AIMED = 44, STARTED = 0, REBASE = 1, REMAINING = 2, LENGTH = 3, BEHIND = 4,
    OK = 0, NOT_FINITE = 5, JOINT_LIMIT = 6, TOO_LARGE = 7, RATE_LIMIT = 8, DYNAMIC = 256, RAMPING = 512,
    REVERSING = 1024, DAMPED = 2048, RESIDUAL = 4096, SATURATED = 8192, SLOWED = 16384, UNSURE = 32768,
    NEAR_REVERSAL = 65536
};
#define WAVE 0.0
#define LINEAR 1.0
#define SPRING 2.0
#define SINES 3.0
#define LAG 4.0
#define POLYNOMIAL 5.0

/* ---- arm/se3 --------------------------------------------------------------------------------------------- */

#define HALF_PI_HIGH 1.5707963267341256
#define HALF_PI_LOW 6.077100506506192e-11

/* Cross product of two vectors. */
static tuple3 cross(double a0, double a1, double a2, double b0, double b1, double b2)
{
    return (tuple3){{a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0}};
}

/* Product of two frames. */
static tuple12 product(tuple12 A, tuple12 B)
{
    return (tuple12){{A.at[0] * B.at[0] + A.at[1] * B.at[3] + A.at[2] * B.at[6],
        A.at[0] * B.at[1] + A.at[1] * B.at[4] + A.at[2] * B.at[7],
        A.at[0] * B.at[2] + A.at[1] * B.at[5] + A.at[2] * B.at[8],
        A.at[3] * B.at[0] + A.at[4] * B.at[3] + A.at[5] * B.at[6],
        A.at[3] * B.at[1] + A.at[4] * B.at[4] + A.at[5] * B.at[7],
        A.at[3] * B.at[2] + A.at[4] * B.at[5] + A.at[5] * B.at[8],
        A.at[6] * B.at[0] + A.at[7] * B.at[3] + A.at[8] * B.at[6],
        A.at[6] * B.at[1] + A.at[7] * B.at[4] + A.at[8] * B.at[7],
        A.at[6] * B.at[2] + A.at[7] * B.at[5] + A.at[8] * B.at[8],
        A.at[0] * B.at[9] + A.at[1] * B.at[10] + A.at[2] * B.at[11] + A.at[9],
        A.at[3] * B.at[9] + A.at[4] * B.at[10] + A.at[5] * B.at[11] + A.at[10],
        A.at[6] * B.at[9] + A.at[7] * B.at[10] + A.at[8] * B.at[11] + A.at[11]}};
}

/* Frame A rotated about its z by the angle of sine s and cosine c. */
static tuple12 rotated_z(tuple12 A, double s, double c)
{
    return (tuple12){{c * A.at[0] + s * A.at[1], c * A.at[1] - s * A.at[0], A.at[2], c * A.at[3] + s * A.at[4],
        c * A.at[4] - s * A.at[3], A.at[5], c * A.at[6] + s * A.at[7], c * A.at[7] - s * A.at[6], A.at[8], A.at[9],
        A.at[10], A.at[11]}};
}

/* Frame A shifted along its z by d. */
static tuple12 shifted_z(tuple12 A, double d)
{
    return (tuple12){{A.at[0], A.at[1], A.at[2], A.at[3], A.at[4], A.at[5], A.at[6], A.at[7], A.at[8],
        A.at[9] + A.at[2] * d, A.at[10] + A.at[5] * d, A.at[11] + A.at[8] * d}};
}

/* Sine and cosine up to pi/4. */
static tuple2 sine_cosine_octant(double x)
{
    double z = x * x;
    double s = x * (1.0 + z * (-0.16666666666666666 + z * (0.008333333333333333 + z * (-0.0001984126984126984 + z *
        (2.7557319223985893e-06 + z * (-2.505210838544172e-08 + z * (1.6059043836821613e-10 - z *
        7.647163731819816e-13)))))));
    double c = 1.0 + z * (-0.5 + z * (0.041666666666666664 + z * (-0.001388888888888889 + z * (2.48015873015873e-05 + z
        * (-2.755731922398589e-07 + z * (2.08767569878681e-09 + z * (-1.1470745597729725e-11 + z *
        4.779477332387385e-14)))))));
    return (tuple2){{s, c}};
}

/* Sine and cosine of an angle of some revolutions, to the last digit or two. */
static tuple2 sine_cosine(double x)
{
    double k = floor(x * (2.0 / 3.14159265358979323846) + 0.5);
    /* a NaN has no quadrant */
    if (!(fabs(k) <= 100000.0)) {
        return (tuple2){{sin(x), cos(x)}};
    }
    const tuple2 got1 = sine_cosine_octant(x - k * HALF_PI_HIGH - k * HALF_PI_LOW);
    double s = got1.at[0];
    double c = got1.at[1];
    int quadrant = (int)k & 3;
    if (quadrant == 0) {
        return (tuple2){{s, c}};
    }
    if (quadrant == 1) {
        return (tuple2){{c, -s}};
    }
    if (quadrant == 2) {
        return (tuple2){{-s, -c}};
    }
    return (tuple2){{-c, s}};
}

SCALAR
/* Sine and cosine of a + d from those of a: the series is exact to 1e-17 up to 0.03 rad. */
static tuple2 sine_cosine_near(double s, double c, double d)
{
    double sd = 0.0;
    double cd = 0.0;
    if (fabs(d) < 0.03) {
        double d2 = d * d;
        sd = d * (1.0 - d2 * (1.0 / 6.0 - d2 * (1.0 / 120.0 - d2 / 5040.0)));
        cd = 1.0 - d2 * (0.5 - d2 * (1.0 / 24.0 - d2 * (1.0 / 720.0 - d2 / 40320.0)));
    } else {
        sd = sin(d);
        cd = cos(d);
    }
    return (tuple2){{s * cd + c * sd, c * cd - s * sd}};
}
SCALAR_END

/* sin t / t, (1 - cos t) / t² and (t - sin t) / t³ of the square of an angle. */
static tuple3 angle_series(double t2)
{
    double a = 0.0;
    double b = 0.0;
    double c = 0.0;
    /* exact here, and the closed forms would lose digits to cancellation */
    if (t2 < 0.001) {
        a = 1.0 - t2 * (1.0 / 6.0 - t2 * (1.0 / 120.0 - t2 / 5040.0));
        b = 0.5 - t2 * (1.0 / 24.0 - t2 * (1.0 / 720.0 - t2 / 40320.0));
        c = 1.0 / 6.0 - t2 * (1.0 / 120.0 - t2 * (1.0 / 5040.0 - t2 / 362880.0));
    } else {
        double t = sqrt(t2);
        a = sin(t) / t;
        b = (1.0 - cos(t)) / t2;
        c = (1.0 - a) / t2;
    }
    return (tuple3){{a, b, c}};
}

/* Frame T rotated about its own x and y by the rotation vector (x, y, 0). */
static tuple12 rotate_about_xy(tuple12 T, double x, double y)
{
    const tuple3 got1 = angle_series(x * x + y * y);
    double a = got1.at[0];
    double b = got1.at[1];
    double xx = 1.0 - b * y * y;
    double yy = 1.0 - b * x * x;
    double xy = b * x * y;
    double sx = a * x;
    double sy = a * y;
    double zz = 1.0 - b * (x * x + y * y);
    return (tuple12){{T.at[0] * xx + T.at[1] * xy - T.at[2] * sy, T.at[0] * xy + T.at[1] * yy + T.at[2] * sx,
        T.at[0] * sy - T.at[1] * sx + T.at[2] * zz, T.at[3] * xx + T.at[4] * xy - T.at[5] * sy,
        T.at[3] * xy + T.at[4] * yy + T.at[5] * sx, T.at[3] * sy - T.at[4] * sx + T.at[5] * zz,
        T.at[6] * xx + T.at[7] * xy - T.at[8] * sy, T.at[6] * xy + T.at[7] * yy + T.at[8] * sx,
        T.at[6] * sy - T.at[7] * sx + T.at[8] * zz, T.at[9], T.at[10], T.at[11]}};
}

/* exp of the twist (v, w) as a frame. */
static tuple12 exponential(double v0, double v1, double v2, double w0, double w1, double w2)
{
    const tuple3 got1 = angle_series(w0 * w0 + w1 * w1 + w2 * w2);
    double a = got1.at[0];
    double b = got1.at[1];
    double c = got1.at[2];
    /* left Jacobian of SO(3) times v */
    double d = w0 * v0 + w1 * v1 + w2 * v2;
    return (tuple12){{1.0 - b * (w1 * w1 + w2 * w2), b * w0 * w1 - a * w2, b * w0 * w2 + a * w1, b * w0 * w1 + a * w2,
        1.0 - b * (w0 * w0 + w2 * w2), b * w1 * w2 - a * w0, b * w0 * w2 - a * w1, b * w1 * w2 + a * w0,
        1.0 - b * (w0 * w0 + w1 * w1), a * v0 + b * (w1 * v2 - w2 * v1) + c * d * w0,
        a * v1 + b * (w2 * v0 - w0 * v2) + c * d * w1, a * v2 + b * (w0 * v1 - w1 * v0) + c * d * w2}};
}

/* Rotation vector from frame A to frame B, in A. */
static tuple3 rotation_between(tuple12 A, tuple12 B)
{
    double x = 0.5 * (A.at[2] * B.at[1] + A.at[5] * B.at[4] + A.at[8] * B.at[7] - A.at[1] * B.at[2] - A.at[4] * B.at[5]
        - A.at[7] * B.at[8]);
    double y = 0.5 * (A.at[0] * B.at[2] + A.at[3] * B.at[5] + A.at[6] * B.at[8] - A.at[2] * B.at[0] - A.at[5] * B.at[3]
        - A.at[8] * B.at[6]);
    double z = 0.5 * (A.at[1] * B.at[0] + A.at[4] * B.at[3] + A.at[7] * B.at[6] - A.at[0] * B.at[1] - A.at[3] * B.at[4]
        - A.at[6] * B.at[7]);
    double s2 = x * x + y * y + z * z;
    double f = 0.0;
    if (s2 < 1e-06) {
        f = 1.0 + s2 / 6.0 * (1.0 + 0.45 * s2);
    } else {
        double s = sqrt(s2);
        double trace = 0.0;
        for (int i = 0; i < 9; i++) {
            trace += A.at[i] * B.at[i];
        }
        f = atan2(s, 0.5 * (trace - 1.0)) / s;
    }
    return (tuple3){{f * x, f * y, f * z}};
}

/* ---- correct/chain --------------------------------------------------------------------------------------- */

/* Constant transform in P[k, c:c + 12] as (R row by row, p). */
static tuple12 constant(rows P, int k, int c)
{
    return (tuple12){{P.at[k][c], P.at[k][c + 1], P.at[k][c + 2], P.at[k][c + 3], P.at[k][c + 4], P.at[k][c + 5],
        P.at[k][c + 6], P.at[k][c + 7], P.at[k][c + 8], P.at[k][c + 9], P.at[k][c + 10], P.at[k][c + 11]}};
}

/* Tool frame of the nominal chain at the wanted joints; writes nothing but, when told to, the joint lines. */
static tuple12 wanted_tool(rows P, matrix W, int m, int oj, bool lines)
{
    tuple12 T = constant(P, 0, NOMINAL);
    for (int k = 0; k < m; k++) {
        if (k > 0) {
            T = product(T, constant(P, k, NOMINAL));
        }
        if (P.at[k][KIND] == 0.0) {
            T = rotated_z(T, W[k][SINE], W[k][COSINE]);
        } else {
            T = shifted_z(T, P.at[k][RATIO] * W[oj + (int)P.at[k][JOINT]][WANTED]);
        }
        if (lines) {
            W[k][LINE] = T.at[2];
            W[k][LINE + 1] = T.at[5];
            W[k][LINE + 2] = T.at[8];
            W[k][LINE + 3] = T.at[9];
            W[k][LINE + 4] = T.at[10];
            W[k][LINE + 5] = T.at[11];
        }
    }
    return product(T, constant(P, m, NOMINAL));
}

/* Write the frame T to W[k, c:c + 12]. */
static void put_frame(matrix W, int k, int c, tuple12 T)
{
    W[k][c] = T.at[0];
    W[k][c + 1] = T.at[1];
    W[k][c + 2] = T.at[2];
    W[k][c + 3] = T.at[3];
    W[k][c + 4] = T.at[4];
    W[k][c + 5] = T.at[5];
    W[k][c + 6] = T.at[6];
    W[k][c + 7] = T.at[7];
    W[k][c + 8] = T.at[8];
    W[k][c + 9] = T.at[9];
    W[k][c + 10] = T.at[10];
    W[k][c + 11] = T.at[11];
}

/* Frames of the load chain, in rows from at on (0: the nominal one), at the command into W; returns the tool. */
static tuple12 load_frames(rows P, matrix W, int at, int m, int oj)
{
    tuple12 T = constant(P, at, NOMINAL);
    for (int k = 0; k < m; k++) {
        if (k > 0) {
            T = product(T, constant(P, at + k, NOMINAL));
        }
        int j = oj + (int)P.at[k][JOINT];
        double shift = P.at[k][RATIO] * (W[j][COMMAND] - W[j][WANTED]);
        if (P.at[k][KIND] == 0.0) {
            const tuple2 got1 = sine_cosine_near(W[k][SINE], W[k][COSINE], shift);
            double s = got1.at[0];
            double c = got1.at[1];
            T = rotated_z(T, s, c);
        } else {
            T = shifted_z(T, P.at[k][RATIO] * W[j][COMMAND]);
        }
        put_frame(W, k, 0, T);
    }
    return product(T, constant(P, at + m, NOMINAL));
}

/* Frame T behind move k at the command of joint row j with its local correction. */
static tuple12 frame_after_move(rows P, matrix W, int k, int j, tuple12 T)
{
    if (P.at[k][KIND] == 0.0) {
        double shift = P.at[k][RATIO] * (W[j][COMMAND] - W[j][WANTED] + W[j][SHIFT]);
        const tuple2 got1 = sine_cosine_near(W[k][SINE], W[k][COSINE], shift);
        double s = got1.at[0];
        double c = got1.at[1];
        return rotated_z(T, s, c);
    }
    return shifted_z(T, P.at[k][RATIO] * (W[j][COMMAND] + W[j][SHIFT]));
}

/* Frame T behind the twist of joint row j. */
static tuple12 frame_after_twist(rows P, matrix W, int j, tuple12 T)
{
    if (P.at[j][TWISTED] != 0.0) {
        double *t = W[j];
        return product(T, exponential(t[TWIST], t[TWIST + 1], t[TWIST + 2], t[TWIST + 3], t[TWIST + 4], t[TWIST + 5]));
    }
    return rotate_about_xy(T, W[j][TWIST + 3], W[j][TWIST + 4]);
}

/* Frames of the load chain at the command with the local corrections in W, and those behind the twists, into W. */
static void hanging_frames(rows P, matrix W, int at, int m, int oj)
{
    tuple12 T = constant(P, at, NOMINAL);
    for (int k = 0; k < m; k++) {
        if (k > 0) {
            T = product(T, constant(P, at + k, NOMINAL));
        }
        int j = oj + (int)P.at[k][JOINT];
        T = frame_after_move(P, W, k, j, T);
        put_frame(W, k, 0, T);
        if (P.at[k][PRIMARY] >= 0.0) {
            T = frame_after_twist(P, W, j, T);
        }
        put_frame(W, k, BEHIND_TWIST, T);
    }
}

/* Start of the identified chain: a base mount that deflects tilts it by the load on the base. */
static tuple12 base_frame(rows P, matrix W, int m)
{
    int S = P.count - 1;
    if (P.at[S][MOUNT] == 0.0) {
        return constant(P, 0, IDENTIFIED);
    }
    double x = P.at[S - 1][MOUNT_X] * (W[m][ON_BASE] + P.at[S - 1][FIXED_MOMENT_X]);
    double y = P.at[S - 1][MOUNT_Y] * (W[m][ON_BASE + 1] + P.at[S - 1][FIXED_MOMENT_Y]);
    return product(rotate_about_xy(constant(P, S - 1, BASE_FRAME), x, y), constant(P, S - 1, FIRST_MOVE));
}

/* Tool frame of the identified chain at the command, with the local corrections in W; joint lines into W. */
static tuple12 identified_tool(rows P, matrix W, int m, int oj)
{
    tuple12 T = base_frame(P, W, m);
    for (int k = 0; k < m; k++) {
        if (k > 0) {
            T = product(T, constant(P, k, IDENTIFIED));
        }
        int j = oj + (int)P.at[k][JOINT];
        T = frame_after_move(P, W, k, j, T);
        W[k][LINE] = T.at[2];
        W[k][LINE + 1] = T.at[5];
        W[k][LINE + 2] = T.at[8];
        W[k][LINE + 3] = T.at[9];
        W[k][LINE + 4] = T.at[10];
        W[k][LINE + 5] = T.at[11];
        if (P.at[k][PRIMARY] >= 0.0) {
            T = frame_after_twist(P, W, j, T);
        }
    }
    return product(T, constant(P, m, IDENTIFIED));
}

/* ---- correct/newton_euler -------------------------------------------------------------------------------- */

/* Add what of a load on axis k, in base coordinates, works on joint row j through a linkage (virtual work). */
static void through_linkage(rows P, matrix W, int k, int j, double x, double y, double z, double f0, double f1,
    double f2)
{
    if (P.at[k][KIND] == 0.0) {
        W[j][MOMENT + 2] += P.at[k][CARRIED] * (W[k][2] * x + W[k][5] * y + W[k][8] * z);
    } else {
        W[j][MOMENT + 2] += P.at[k][CARRIED] * (W[k][2] * f0 + W[k][5] * f1 + W[k][8] * f2);
    }
}

/* Base coordinates of a point of the frame of row k from column ride on. */
static tuple3 point(matrix W, int k, int ride, double x, double y, double z)
{
    return (tuple3){{W[k][ride] * x + W[k][ride + 1] * y + W[k][ride + 2] * z + W[k][ride + 9],
        W[k][ride + 3] * x + W[k][ride + 4] * y + W[k][ride + 5] * z + W[k][ride + 10],
        W[k][ride + 6] * x + W[k][ride + 7] * y + W[k][ride + 8] * z + W[k][ride + 11]}};
}

/* Add what works on the joints through linkages from gravity alone, see `_static_moments`. */
static void static_linkages(rows P, matrix W, int S, int m, int oj, int ride)
{
    double g0 = P.at[S][GRAVITY];
    double g1 = P.at[S][GRAVITY + 1];
    double g2 = P.at[S][GRAVITY + 2];
    double mass = P.at[m][MASS];
    const tuple3 got1 = point(W, m - 1, ride, P.at[m][COM], P.at[m][COM + 1], P.at[m][COM + 2]);
    double s0 = got1.at[0];
    double s1 = got1.at[1];
    double s2 = got1.at[2];
    s0 = mass * s0;
    s1 = mass * s1;
    s2 = mass * s2;
    for (int k = m - 1; k > -1; k--) {
        double body = P.at[k][MASS];
        if (body != 0.0) {
            const tuple3 got2 = point(W, k, ride, P.at[k][COM], P.at[k][COM + 1], P.at[k][COM + 2]);
            double c0 = got2.at[0];
            double c1 = got2.at[1];
            double c2 = got2.at[2];
            mass += body;
            s0 = s0 + body * c0;
            s1 = s1 + body * c1;
            s2 = s2 + body * c2;
        }
        if (P.at[k][CARRIED] != 0.0) {
            double r0 = s0 - mass * W[k][9];
            double r1 = s1 - mass * W[k][10];
            double r2 = s2 - mass * W[k][11];
            const tuple3 got3 = cross(r0, r1, r2, g0, g1, g2);
            double t0 = got3.at[0];
            double t1 = got3.at[1];
            double t2 = got3.at[2];
            through_linkage(P, W, k, oj + (int)P.at[k][JOINT], t0, t1, t2, mass * g0, mass * g1, mass * g2);
        }
    }
}

/* Rotate a load in base coordinates into frame k and keep it for joint row j: two moments across,
 * one along the axis. Along the axis a revolute joint feels a moment, a prismatic one a force. */
static void to_joint(rows P, matrix W, int k, int j, double x, double y, double z, double f0, double f1, double f2)
{
    W[j][MOMENT] = W[k][0] * x + W[k][3] * y + W[k][6] * z;
    W[j][MOMENT + 1] = W[k][1] * x + W[k][4] * y + W[k][7] * z;
    if (P.at[k][KIND] == 0.0) {
        W[j][MOMENT + 2] = W[k][2] * x + W[k][5] * y + W[k][8] * z;
    } else {
        W[j][MOMENT + 2] = W[k][2] * f0 + W[k][5] * f1 + W[k][8] * f2;
    }
}

/* Load moments in the joint frames from gravity alone: mass and first moment, from the tool inwards. */
static void static_moments(rows P, matrix W, int S, int m, int oj, int ride)
{
    double g0 = P.at[S][GRAVITY];
    double g1 = P.at[S][GRAVITY + 1];
    double g2 = P.at[S][GRAVITY + 2];
    double mass = P.at[m][MASS];
    const tuple3 got1 = point(W, m - 1, ride, P.at[m][COM], P.at[m][COM + 1], P.at[m][COM + 2]);
    double s0 = got1.at[0];
    double s1 = got1.at[1];
    double s2 = got1.at[2];
    s0 = mass * s0;
    s1 = mass * s1;
    s2 = mass * s2;
    for (int k = m - 1; k > -1; k--) {
        double body = P.at[k][MASS];
        if (body != 0.0) {
            const tuple3 got2 = point(W, k, ride, P.at[k][COM], P.at[k][COM + 1], P.at[k][COM + 2]);
            double c0 = got2.at[0];
            double c1 = got2.at[1];
            double c2 = got2.at[2];
            mass += body;
            s0 = s0 + body * c0;
            s1 = s1 + body * c1;
            s2 = s2 + body * c2;
        }
        if (P.at[k][PRIMARY] >= 0.0) {
            double r0 = s0 - mass * W[k][9];
            double r1 = s1 - mass * W[k][10];
            double r2 = s2 - mass * W[k][11];
            const tuple3 got3 = cross(r0, r1, r2, g0, g1, g2);
            double t0 = got3.at[0];
            double t1 = got3.at[1];
            double t2 = got3.at[2];
            to_joint(P, W, k, oj + (int)P.at[k][JOINT], t0, t1, t2, mass * g0, mass * g1, mass * g2);
        }
    }
    if (P.at[m][CARRIED] != 0.0) {
        static_linkages(P, W, S, m, oj, ride);
    }
}

/* Acceleration of a point at r on a body that rotates with w and dw: dw x r + w x (w x r). */
static tuple3 point_acceleration(tuple3 w, tuple3 dw, double r0, double r1, double r2)
{
    const tuple3 got1 = cross(dw.at[0], dw.at[1], dw.at[2], r0, r1, r2);
    double a0 = got1.at[0];
    double a1 = got1.at[1];
    double a2 = got1.at[2];
    const tuple3 got2 = cross(w.at[0], w.at[1], w.at[2], r0, r1, r2);
    double t0 = got2.at[0];
    double t1 = got2.at[1];
    double t2 = got2.at[2];
    const tuple3 got3 = cross(w.at[0], w.at[1], w.at[2], t0, t1, t2);
    double u0 = got3.at[0];
    double u1 = got3.at[1];
    double u2 = got3.at[2];
    return (tuple3){{a0 + u0, a1 + u1, a2 + u2}};
}

/* A vector in base coordinates rotated into the frame of row k from column ride on. */
static tuple3 inward(matrix W, int k, int ride, double x, double y, double z)
{
    return (tuple3){{W[k][ride] * x + W[k][ride + 3] * y + W[k][ride + 6] * z,
        W[k][ride + 1] * x + W[k][ride + 4] * y + W[k][ride + 7] * z,
        W[k][ride + 2] * x + W[k][ride + 5] * y + W[k][ride + 8] * z}};
}

/* Force and moment about the origin of its frame of the body in row row, in the axes of that frame (d'Alembert). w,
 * dw and a (gravity minus acceleration of the origin) are in the same axes. */
static tuple6 body_load(rows P, int row, tuple3 w, tuple3 dw, tuple3 a)
{
    double mass = P.at[row][MASS];
    double c0 = P.at[row][COM];
    double c1 = P.at[row][COM + 1];
    double c2 = P.at[row][COM + 2];
    const tuple3 got1 = point_acceleration(w, dw, c0, c1, c2);
    double s0 = got1.at[0];
    double s1 = got1.at[1];
    double s2 = got1.at[2];
    double f0 = mass * (a.at[0] - s0);
    double f1 = mass * (a.at[1] - s1);
    double f2 = mass * (a.at[2] - s2);
    double xx = P.at[row][INERTIA];
    double yy = P.at[row][INERTIA + 1];
    double zz = P.at[row][INERTIA + 2];
    double xy = P.at[row][INERTIA + 3];
    double xz = P.at[row][INERTIA + 4];
    double yz = P.at[row][INERTIA + 5];
    double h0 = xx * w.at[0] + xy * w.at[1] + xz * w.at[2];
    double h1 = xy * w.at[0] + yy * w.at[1] + yz * w.at[2];
    double h2 = xz * w.at[0] + yz * w.at[1] + zz * w.at[2];
    const tuple3 got2 = cross(w.at[0], w.at[1], w.at[2], h0, h1, h2);
    double t0 = got2.at[0];
    double t1 = got2.at[1];
    double t2 = got2.at[2];
    const tuple3 got3 = cross(c0, c1, c2, f0, f1, f2);
    double m0 = got3.at[0];
    double m1 = got3.at[1];
    double m2 = got3.at[2];
    m0 -= t0 + xx * dw.at[0] + xy * dw.at[1] + xz * dw.at[2];
    m1 -= t1 + xy * dw.at[0] + yy * dw.at[1] + yz * dw.at[2];
    m2 -= t2 + xz * dw.at[0] + yz * dw.at[1] + zz * dw.at[2];
    return (tuple6){{f0, f1, f2, m0, m1, m2}};
}

/* Load of the body in row row that rides on the frame of row k, column ride, about the base origin and in its axes. */
static void body_wrench(rows P, matrix W, int row, int k, int ride, tuple3 w, tuple3 dw, tuple3 a)
{
    if (P.at[row][MASS] == 0.0) {
        for (int i = 0; i < 6; i++) {
            W[row][LOAD + i] = 0.0;
        }
        return;
    }
    const tuple6 got1 = body_load(P, row, w, dw, a);
    double x0 = got1.at[0];
    double x1 = got1.at[1];
    double x2 = got1.at[2];
    double y0 = got1.at[3];
    double y1 = got1.at[4];
    double y2 = got1.at[5];
    double f0 = W[k][ride] * x0 + W[k][ride + 1] * x1 + W[k][ride + 2] * x2;
    double f1 = W[k][ride + 3] * x0 + W[k][ride + 4] * x1 + W[k][ride + 5] * x2;
    double f2 = W[k][ride + 6] * x0 + W[k][ride + 7] * x1 + W[k][ride + 8] * x2;
    const tuple3 got2 = cross(W[k][ride + 9], W[k][ride + 10], W[k][ride + 11], f0, f1, f2);
    double t0 = got2.at[0];
    double t1 = got2.at[1];
    double t2 = got2.at[2];
    W[row][LOAD] = f0;
    W[row][LOAD + 1] = f1;
    W[row][LOAD + 2] = f2;
    W[row][LOAD + 3] = t0 + W[k][ride] * y0 + W[k][ride + 1] * y1 + W[k][ride + 2] * y2;
    W[row][LOAD + 4] = t1 + W[k][ride + 3] * y0 + W[k][ride + 4] * y1 + W[k][ride + 5] * y2;
    W[row][LOAD + 5] = t2 + W[k][ride + 6] * y0 + W[k][ride + 7] * y1 + W[k][ride + 8] * y2;
}

/* Outward pass of Newton and Euler in base coordinates: load of every body into W. */
static void moving_bodies(rows P, matrix W, int S, int m, int oj, int ride)
{
    double g0 = P.at[S][GRAVITY];
    double g1 = P.at[S][GRAVITY + 1];
    double g2 = P.at[S][GRAVITY + 2];
    tuple3 w = (tuple3){{0.0, 0.0, 0.0}};
    tuple3 dw = (tuple3){{0.0, 0.0, 0.0}};
    tuple3 acc = (tuple3){{0.0, 0.0, 0.0}};
    tuple3 p = (tuple3){{0.0, 0.0, 0.0}};
    for (int k = 0; k < m; k++) {
        int j = oj + (int)P.at[k][JOINT];
        double speed = P.at[k][RATIO] * W[j][SPEED_NOW];
        double rate = P.at[k][RATIO] * W[j][ACCEL_NOW];
        double z0 = W[k][2];
        double z1 = W[k][5];
        double z2 = W[k][8];
        const tuple3 got1 = point_acceleration(w, dw, W[k][9] - p.at[0], W[k][10] - p.at[1], W[k][11] - p.at[2]);
        double s0 = got1.at[0];
        double s1 = got1.at[1];
        double s2 = got1.at[2];
        acc = (tuple3){{acc.at[0] + s0, acc.at[1] + s1, acc.at[2] + s2}};
        const tuple3 got2 = cross(w.at[0], w.at[1], w.at[2], z0, z1, z2);
        double t0 = got2.at[0];
        double t1 = got2.at[1];
        double t2 = got2.at[2];
        if (P.at[k][KIND] == 0.0) {
            dw = (tuple3){{dw.at[0] + rate * z0 + speed * t0, dw.at[1] + rate * z1 + speed * t1,
                dw.at[2] + rate * z2 + speed * t2}};
            w = (tuple3){{w.at[0] + speed * z0, w.at[1] + speed * z1, w.at[2] + speed * z2}};
        } else {
            double twice = 2.0 * speed;
            acc = (tuple3){{acc.at[0] + twice * t0 + rate * z0, acc.at[1] + twice * t1 + rate * z1,
                acc.at[2] + twice * t2 + rate * z2}};
        }
        p = (tuple3){{W[k][ride + 9], W[k][ride + 10], W[k][ride + 11]}};
        if (ride > 0) {
            const tuple3 got3 = point_acceleration(w, dw, p.at[0] - W[k][9], p.at[1] - W[k][10], p.at[2] - W[k][11]);
            s0 = got3.at[0];
            s1 = got3.at[1];
            s2 = got3.at[2];
            acc = (tuple3){{acc.at[0] + s0, acc.at[1] + s1, acc.at[2] + s2}};
        }
        tuple3 inside = inward(W, k, ride, w.at[0], w.at[1], w.at[2]);
        tuple3 turning = inward(W, k, ride, dw.at[0], dw.at[1], dw.at[2]);
        tuple3 falling = inward(W, k, ride, g0 - acc.at[0], g1 - acc.at[1], g2 - acc.at[2]);
        body_wrench(P, W, k, k, ride, inside, turning, falling);
        if (k == m - 1) {
            body_wrench(P, W, m, k, ride, inside, turning, falling);
        }
    }
}

/* Add what works on the joints through linkages, from the loads of the bodies in W. */
static void dynamic_linkages(rows P, matrix W, int m, int oj)
{
    tuple3 f = (tuple3){{W[m][LOAD], W[m][LOAD + 1], W[m][LOAD + 2]}};
    tuple3 t = (tuple3){{W[m][LOAD + 3], W[m][LOAD + 4], W[m][LOAD + 5]}};
    for (int k = m - 1; k > -1; k--) {
        f = (tuple3){{f.at[0] + W[k][LOAD], f.at[1] + W[k][LOAD + 1], f.at[2] + W[k][LOAD + 2]}};
        t = (tuple3){{t.at[0] + W[k][LOAD + 3], t.at[1] + W[k][LOAD + 4], t.at[2] + W[k][LOAD + 5]}};
        if (P.at[k][CARRIED] != 0.0) {
            const tuple3 got1 = cross(W[k][9], W[k][10], W[k][11], f.at[0], f.at[1], f.at[2]);
            double s0 = got1.at[0];
            double s1 = got1.at[1];
            double s2 = got1.at[2];
            through_linkage(P, W, k, oj + (int)P.at[k][JOINT], t.at[0] - s0, t.at[1] - s1, t.at[2] - s2, f.at[0],
                f.at[1], f.at[2]);
        }
    }
}

/* A wrench about the base origin as one about and in the frame of row k from column ride on, for joint row j. */
static void keep_wrench(matrix W, int k, int ride, int j, int column, tuple3 f, tuple3 t)
{
    const tuple3 got1 = cross(W[k][ride + 9], W[k][ride + 10], W[k][ride + 11], f.at[0], f.at[1], f.at[2]);
    double s0 = got1.at[0];
    double s1 = got1.at[1];
    double s2 = got1.at[2];
    tuple3 force = inward(W, k, ride, f.at[0], f.at[1], f.at[2]);
    tuple3 moment = inward(W, k, ride, t.at[0] - s0, t.at[1] - s1, t.at[2] - s2);
    for (int i = 0; i < 3; i++) {
        W[j][column + i] = force.at[i];
        W[j][column + 3 + i] = moment.at[i];
    }
}

/* Load moments in the joint frames from gravity and motion (thesis eq. 5.14, with the sign of the load). */
static void dynamic_moments(rows P, matrix W, int S, int m, int oj, int ride)
{
    moving_bodies(P, W, S, m, oj, ride);
    bool bending = P.at[S][BENDINGS] != 0.0;
    tuple3 f = (tuple3){{W[m][LOAD], W[m][LOAD + 1], W[m][LOAD + 2]}};
    tuple3 t = (tuple3){{W[m][LOAD + 3], W[m][LOAD + 4], W[m][LOAD + 5]}};
    tuple3 beyond = f;
    tuple3 turned = t;
    for (int k = m - 1; k > -1; k--) {
        f = (tuple3){{f.at[0] + W[k][LOAD], f.at[1] + W[k][LOAD + 1], f.at[2] + W[k][LOAD + 2]}};
        t = (tuple3){{t.at[0] + W[k][LOAD + 3], t.at[1] + W[k][LOAD + 4], t.at[2] + W[k][LOAD + 5]}};
        if (P.at[k][PRIMARY] >= 0.0) {
            int j = oj + (int)P.at[k][JOINT];
            const tuple3 got1 = cross(W[k][9], W[k][10], W[k][11], f.at[0], f.at[1], f.at[2]);
            double s0 = got1.at[0];
            double s1 = got1.at[1];
            double s2 = got1.at[2];
            to_joint(P, W, k, j, t.at[0] - s0, t.at[1] - s1, t.at[2] - s2, f.at[0], f.at[1], f.at[2]);
            if (bending) {
                keep_wrench(W, k, 0, j, ROOT, f, t);
                keep_wrench(W, k, ride, j, END, beyond, turned);
                beyond = f;
                turned = t;
            }
        }
    }
    W[m][ON_BASE] = t.at[0];
    W[m][ON_BASE + 1] = t.at[1];
    if (P.at[m][CARRIED] != 0.0) {
        dynamic_linkages(P, W, m, oj);
    }
}

/* Load moments at the frames now in W; bending rows and the base mount need whole wrenches,
 * which the general pass has. The bodies ride on the frames from column ride on: 0, those of the joints,
 * or BEHIND_TWIST. */
static void load_moments(rows P, matrix W, int S, int m, int oj, bool dynamic, int ride)
{
    if (dynamic || P.at[S][BENDINGS] != 0.0 || P.at[S][MOUNT] != 0.0) {
        dynamic_moments(P, W, S, m, oj, ride);
    } else {
        static_moments(P, W, S, m, oj, ride);
    }
}

/* ---- correct/effects ------------------------------------------------------------------------------------- */

#define NO_MOMENT 1e-09
#define SOFT 3.8
#define COUNTS 3e-07

/* sign(x), or tanh(x / width): beyond 19.1 widths the two are the same number. */
static double soft_sign(double x, double width)
{
    double size = fabs(x);
    if (size >= 19.1 * width) {
        return x != 0.0 ? copysign(1.0, x) : 0.0;
    }
    return copysign(1.0 - 2.0 / (exp(2.0 * size / width) + 1.0), x);
}

/* a / sqrt(1 + a²); the series is exact up to a degree. */
static double soft_saturation(double a)
{
    double z = a * a;
    if (z < 0.0004) {
        return a * (1.0 - z * (0.5 - z * (0.375 - z * (0.3125 - z * 0.2734375))));
    }
    return a / sqrt(1.0 + z);
}

/* Tilt of a joint in its clearance (thesis eq. 5.16-5.18) towards the transverse load (x, y). */
static tuple2 clearance_tilt(rows P, int j, double x, double y, double soft)
{
    double t = P.at[j][TILT];
    double ax = fabs(x);
    double ay = fabs(y);
    double total = ax + ay;
    if (t == 0.0 || total <= NO_MOMENT) {
        return (tuple2){{0.0, 0.0}};
    }
    double s = 0.0;
    double c = 0.0;
    if (P.at[j][TILT_SHARE] == 0.0) {
        if (ax < ay) {
            const tuple2 got1 = sine_cosine_octant(ax / total * (0.5 * 3.14159265358979323846));
            s = got1.at[0];
            c = got1.at[1];
        } else {
            const tuple2 got2 = sine_cosine_octant(ay / total * (0.5 * 3.14159265358979323846));
            c = got2.at[0];
            s = got2.at[1];
        }
    } else {
        double h = 1.0 / sqrt(x * x + y * y);
        s = ax * h;
        c = ay * h;
    }
    return (tuple2){{soft_saturation(t * s * soft_sign(x, soft)), soft_saturation(t * c * soft_sign(y, soft))}};
}

/* target, or as far towards it from last as reach allows. */
static double rate_limited(double last, double target, double reach)
{
    double change = target - last;
    if (fabs(change) <= reach) {
        return target;
    }
    return last + copysign(reach, change);
}

/* Tilt about x and y of a joint and the side of its backlash, at the loads and the direction of now. */
static tuple3 signs_of(rows P, matrix W, int j, double tilt_soft, double play_soft)
{
    const tuple2 got1 = clearance_tilt(P, j, W[j][MOMENT], W[j][MOMENT + 1], tilt_soft);
    double a = got1.at[0];
    double b = got1.at[1];
    double about = W[j][MOMENT + 2];
    double side = (0.5 * P.at[j][REVERSAL] + P.at[j][SIDED] * about) * W[j][SIGN];
    if (P.at[j][PLAY] != 0.0 && fabs(about) > NO_MOMENT) {
        side += P.at[j][PLAY] * soft_sign(about, play_soft);
    }
    return (tuple3){{a, b, side}};
}

/* Whether a sign of a joint is softer now than the version has it, by as much as counts. */
static bool is_sign_softened(rows P, matrix W, int j, double a, double b, double side)
{
    double soft = P.at[j][TILT_SOFT];
    double about = fabs(W[j][MOMENT + 2]);
    bool near = P.at[j][TILT] != 0.0 && smaller(fabs(W[j][MOMENT]),
        fabs(W[j][MOMENT + 1])) < SOFT * soft && soft > P.at[j][TILT_OWN];
    if (!near) {
        soft = P.at[j][PLAY_SOFT];
        near = P.at[j][PLAY] != 0.0 && about < SOFT * soft && soft > P.at[j][PLAY_OWN];
    }
    if (!near) {
        return false;
    }
    const tuple3 got1 = signs_of(P, W, j, P.at[j][TILT_OWN], P.at[j][PLAY_OWN]);
    double own_a = got1.at[0];
    double own_b = got1.at[1];
    double own_side = got1.at[2];
    return larger(larger(fabs(own_a - a), fabs(own_b - b)), fabs(own_side - side)) > COUNTS;
}

/* Effects with a sign: tilt and backlash of every joint, held to its rate from the last answer; flags of that. */
static int sign_effects(rows P, matrix W, matrix state, int n, int oj, double dt)
{
    int flags = 0;
    for (int i = 0; i < n; i++) {
        int j = oj + i;
        const tuple3 got1 = signs_of(P, W, j, P.at[j][TILT_SOFT], P.at[j][PLAY_SOFT]);
        double a = got1.at[0];
        double b = got1.at[1];
        double side = got1.at[2];
        if (is_sign_softened(P, W, j, a, b, side)) {
            flags |= NEAR_REVERSAL;
        }
        if (dt < INFINITY) {
            double reach = P.at[j][RATE] * dt;
            W[j][TILT_A] = rate_limited(state[i][LAST_A], a, reach);
            W[j][TILT_B] = rate_limited(state[i][LAST_B], b, reach);
            W[j][SIDE] = rate_limited(state[i][LAST_SIDE], side, reach);
            if (W[j][TILT_A] != a || W[j][TILT_B] != b || W[j][SIDE] != side) {
                flags |= REVERSING;
            }
        } else {
            W[j][TILT_A] = a;
            W[j][TILT_B] = b;
            W[j][SIDE] = side;
        }
    }
    return flags;
}

/* Tilts and sides as the version has them at the loads of now, neither softened nor held; the others are kept. */
static void own_signs(rows P, matrix W, int n, int oj)
{
    for (int j = oj; j < oj + n; j++) {
        W[j][KEPT] = W[j][TILT_A];
        W[j][KEPT + 1] = W[j][TILT_B];
        W[j][KEPT + 2] = W[j][SIDE];
        const tuple3 got1 = signs_of(P, W, j, P.at[j][TILT_OWN], P.at[j][PLAY_OWN]);
        W[j][TILT_A] = got1.at[0];
        W[j][TILT_B] = got1.at[1];
        W[j][SIDE] = got1.at[2];
    }
}

/* Tilts and sides as they were before `own_signs`. */
static void kept_signs(matrix W, int n, int oj)
{
    for (int j = oj; j < oj + n; j++) {
        W[j][TILT_A] = W[j][KEPT];
        W[j][TILT_B] = W[j][KEPT + 1];
        W[j][SIDE] = W[j][KEPT + 2];
    }
}

/* What a curve says at the command. */
static double curve(rows P, matrix W, int row, int oj)
{
    double shape = P.at[row][SHAPE];
    int d = oj + (int)P.at[row][DRIVER];
    double q = W[d][COMMAND];
    if (P.at[row][FADE] > 0.0) {
        q = smaller(larger(q, P.at[row][FROM]), P.at[row][TO]);
    }
    double s = 0.0;
    double c = 0.0;
    if (shape == WAVE) {
        const tuple2 got1 = sine_cosine(P.at[row][FACTOR] * q);
        s = got1.at[0];
        c = got1.at[1];
        return P.at[row][AMPLITUDE_A] * s + P.at[row][AMPLITUDE_B] * c;
    }
    if (shape == LINEAR) {
        return P.at[row][AMPLITUDE_A] * q;
    }
    if (shape == LAG) {
        return -P.at[row][AMPLITUDE_A] * W[d][SPEED_NOW];
    }
    if (shape == SINES) {
        return P.at[row][AMPLITUDE_A] * sin(q) * sin(W[oj + (int)P.at[row][CURVED]][COMMAND]);
    }
    if (shape == POLYNOMIAL) {
        double u = smaller(1.0, larger(-1.0, (q - P.at[row][EXTRA]) / P.at[row][EXTRA + 1]));
        double total = 0.0;
        for (int k = 0; k < HIGHEST - POWERS + 1; k++) {
            total = total * u + P.at[row][HIGHEST - k];
        }
        return total;
    }
    double a = P.at[row][EXTRA];
    double b = P.at[row][EXTRA + 1];
    const tuple2 got2 = sine_cosine(q + P.at[row][EXTRA + 2]);
    s = got2.at[0];
    c = got2.at[1];
    double length = sqrt(a * a + b * b - 2.0 * a * b * c);
    return -P.at[row][AMPLITUDE_A] * s * (1.0 - P.at[row][EXTRA + 3] / length);
}

/* Add what the curves of the joints say at the command, to it or to the twist behind it. */
static void joint_curves(rows P, matrix W, int n, int m, int oj)
{
    int first = m + 1 + n;
    for (int row = first; row < first + (int)P.at[P.count - 1][CURVES]; row++) {
        int j = oj + (int)P.at[row][CURVED];
        int moved = (int)P.at[row][MOVED];
        int at = moved == 0 ? SHIFT : TWIST + moved - 1;
        double value = curve(P, W, row, oj);
        if (P.at[row][FADE] > 0.0) {
            double q = W[oj + (int)P.at[row][DRIVER]][COMMAND];
            double beyond = smaller(larger(larger(P.at[row][FROM] - q, q - P.at[row][TO]), 0.0) / P.at[row][FADE], 1.0);
            value -= beyond * beyond * (3.0 - 2.0 * beyond) * (value - P.at[row][MEAN]);
        }
        W[j][at] += value;
    }
}

/* Power of the length that stands out at joint row j; 1 where a bending row has none. */
static double reach_of(rows P, matrix W, int row, int j)
{
    double length = larger(0.0, P.at[row][WAY] * (W[j][COMMAND] - P.at[row][ROOTED]));
    double out = 1.0;
    for (int _ = 0; _ < (int)P.at[row][POWER]; _++) {
        out *= length;
    }
    return out;
}

/* Add the twists of the bending rows: linear in the loads on a joint and on the end of its link. */
static void bending_rows(rows P, matrix W, int n, int m, int oj)
{
    int S = P.count - 1;
    int first = m + 1 + n + (int)P.at[S][CURVES];
    for (int b = 0; b < (int)P.at[S][BENDINGS]; b++) {
        int row = first + 2 * b;
        int j = oj + (int)P.at[row][BENDING_JOINT];
        double l0 = P.at[row][BENDING_LINK];
        double l1 = P.at[row][BENDING_LINK + 1];
        double l2 = P.at[row][BENDING_LINK + 2];
        tuple3 f = (tuple3){{W[j][END], W[j][END + 1], W[j][END + 2]}};
        const tuple3 got1 = cross(l0, l1, l2, f.at[0], f.at[1], f.at[2]);
        double t0 = got1.at[0];
        double t1 = got1.at[1];
        double t2 = got1.at[2];
        tuple3 t = (tuple3){{W[j][END + 3] - t0, W[j][END + 4] - t1, W[j][END + 5] - t2}};
        double reach = reach_of(P, W, row, j);
        for (int r = 0; r < 6; r++) {
            double total = 0.0;
            int c = 0;
            for (int c_at = 0; c_at < 6; c_at++) {
                c = c_at;
                total += P.at[row][BENDING + 6 * r + c] * W[j][ROOT + c];
            }
            for (int c_at = 0; c_at < 3; c_at++) {
                c = c_at;
                total += P.at[row + 1][BENDING + 6 * r + c] * f.at[c] + P.at[row + 1][BENDING + 6 * r + 3 + c] *
                    t.at[c];
            }
            int at = r + 1 == (int)P.at[row][OF_AXIS] ? SHIFT : TWIST + r;
            W[j][at] += reach * total;
        }
    }
}

/* What every joint adds to its command, and the twist behind it,
 * at the loads and signs now in W. Not sided: with every backlash and clearance in its middle. */
static void deflections(rows P, matrix W, int n, int m, int oj, bool sided)
{
    for (int i = 0; i < n; i++) {
        int j = oj + i;
        double about = W[j][MOMENT + 2];
        double side = sided ? W[j][SIDE] : 0.0;
        double a = sided ? W[j][TILT_A] : 0.0;
        double b = sided ? W[j][TILT_B] : 0.0;
        W[j][SHIFT] = P.at[j][DQ] + side + (P.at[j][COMPLIANCE] - P.at[j][HARDENING] * fabs(about)) * about;
        for (int k = 0; k < 6; k++) {
            W[j][TWIST + k] = P.at[j][XI + k];
        }
        W[j][TWIST + 3] += a + P.at[j][RADIAL] * W[j][MOMENT];
        W[j][TWIST + 4] += b + P.at[j][RADIAL] * W[j][MOMENT + 1];
    }
    int S = P.count - 1;
    if (P.at[S][CURVES] != 0.0) {
        joint_curves(P, W, n, m, oj);
    }
    if (P.at[S][BENDINGS] != 0.0) {
        bending_rows(P, W, n, m, oj);
    }
}

/* ---- correct/solver -------------------------------------------------------------------------------------- */

#define TINY 1e-12

/* J J' into the lower half of the task rows, and what the present correction adds to the residual. All six rows always,
 * written out: rows the task does not hold have no Jacobian and get a one on the diagonal. */
static void normal_matrix(matrix W, int n, int oj, int og, int rows)
{
    double a00 = 0.0;
    double a10 = 0.0;
    double a11 = 0.0;
    double a20 = 0.0;
    double a21 = 0.0;
    double a22 = 0.0;
    double a30 = 0.0;
    double a31 = 0.0;
    double a32 = 0.0;
    double a33 = 0.0;
    a00 = a10 = a11 = a20 = a21 = a22 = a30 = a31 = a32 = a33 = 0.0;
    double a40 = 0.0;
    double a41 = 0.0;
    double a42 = 0.0;
    double a43 = 0.0;
    double a44 = 0.0;
    double a50 = 0.0;
    double a51 = 0.0;
    double a52 = 0.0;
    double a53 = 0.0;
    double a54 = 0.0;
    double a55 = 0.0;
    a40 = a41 = a42 = a43 = a44 = a50 = a51 = a52 = a53 = a54 = a55 = 0.0;
    double g0 = 0.0;
    double g1 = 0.0;
    double g2 = 0.0;
    double g3 = 0.0;
    double g4 = 0.0;
    double g5 = 0.0;
    g0 = g1 = g2 = g3 = g4 = g5 = 0.0;
    double g = 0.0;
    for (int j = oj; j < oj + n; j++) {
        g = W[j][COMMAND] - W[j][WANTED];
        double c0 = W[j][COLUMN];
        double c1 = W[j][COLUMN + 1];
        double c2 = W[j][COLUMN + 2];
        double c3 = W[j][COLUMN + 3];
        double c4 = W[j][COLUMN + 4];
        double c5 = W[j][COLUMN + 5];
        a00 = a00 + c0 * c0;
        a10 = a10 + c1 * c0;
        a11 = a11 + c1 * c1;
        a20 = a20 + c2 * c0;
        a21 = a21 + c2 * c1;
        a22 = a22 + c2 * c2;
        a30 = a30 + c3 * c0;
        a31 = a31 + c3 * c1;
        a32 = a32 + c3 * c2;
        a33 = a33 + c3 * c3;
        a40 = a40 + c4 * c0;
        a41 = a41 + c4 * c1;
        a42 = a42 + c4 * c2;
        a43 = a43 + c4 * c3;
        a44 = a44 + c4 * c4;
        a50 = a50 + c5 * c0;
        a51 = a51 + c5 * c1;
        a52 = a52 + c5 * c2;
        a53 = a53 + c5 * c3;
        a54 = a54 + c5 * c4;
        a55 += c5 * c5;
        g0 = g0 + c0 * g;
        g1 = g1 + c1 * g;
        g2 = g2 + c2 * g;
        g3 = g3 + c3 * g;
        g4 = g4 + c4 * g;
        g5 = g5 + c5 * g;
    }
    int t = MATRIX;
    W[og][t] = a00;
    W[og + 1][t] = a10;
    W[og + 1][t + 1] = a11;
    W[og + 2][t] = a20;
    W[og + 2][t + 1] = a21;
    W[og + 2][t + 2] = a22;
    W[og + 3][t] = a30;
    W[og + 3][t + 1] = a31;
    W[og + 3][t + 2] = a32;
    W[og + 3][t + 3] = a33;
    W[og + 4][t] = a40;
    W[og + 4][t + 1] = a41;
    W[og + 4][t + 2] = a42;
    W[og + 4][t + 3] = a43;
    W[og + 4][t + 4] = a44;
    W[og + 5][t] = a50;
    W[og + 5][t + 1] = a51;
    W[og + 5][t + 2] = a52;
    W[og + 5][t + 3] = a53;
    W[og + 5][t + 4] = a54;
    W[og + 5][t + 5] = a55;
    int r = 0;
    const double each_g[] = {g0, g1, g2, g3, g4, g5};
    for (int r = 0; r < 6; r++) {
        const double g = each_g[r];
        W[og + r][ADDED] = g;
    }
    for (int r_at = rows; r_at < 6; r_at++) {
        r = r_at;
        W[og + r][t + r] = 1.0;
    }
}

/* LDL' of J J' into the task rows, 1 / d on the diagonal; returns the smallest pivot, 0 when there is none. */
static double factor(matrix W, int og)
{
    int t = MATRIX;
    double d0 = W[og][t];
    double i0 = 1.0 / d0;
    double u10 = W[og + 1][t];
    double u20 = W[og + 2][t];
    double u30 = W[og + 3][t];
    double u40 = W[og + 4][t];
    double u50 = W[og + 5][t];
    double l10 = u10 * i0;
    double l20 = u20 * i0;
    double l30 = u30 * i0;
    double l40 = u40 * i0;
    double l50 = u50 * i0;
    double d1 = W[og + 1][t + 1] - l10 * u10;
    double i1 = 1.0 / d1;
    double u21 = W[og + 2][t + 1] - l10 * u20;
    double u31 = W[og + 3][t + 1] - l10 * u30;
    double u41 = W[og + 4][t + 1] - l10 * u40;
    double u51 = W[og + 5][t + 1] - l10 * u50;
    double l21 = u21 * i1;
    double l31 = u31 * i1;
    double l41 = u41 * i1;
    double l51 = u51 * i1;
    double d2 = W[og + 2][t + 2] - l20 * u20 - l21 * u21;
    double i2 = 1.0 / d2;
    double u32 = W[og + 3][t + 2] - l20 * u30 - l21 * u31;
    double u42 = W[og + 4][t + 2] - l20 * u40 - l21 * u41;
    double u52 = W[og + 5][t + 2] - l20 * u50 - l21 * u51;
    double l32 = u32 * i2;
    double l42 = u42 * i2;
    double l52 = u52 * i2;
    double d3 = W[og + 3][t + 3] - l30 * u30 - l31 * u31 - l32 * u32;
    double i3 = 1.0 / d3;
    double u43 = W[og + 4][t + 3] - l30 * u40 - l31 * u41 - l32 * u42;
    double u53 = W[og + 5][t + 3] - l30 * u50 - l31 * u51 - l32 * u52;
    double l43 = u43 * i3;
    double l53 = u53 * i3;
    double d4 = W[og + 4][t + 4] - l40 * u40 - l41 * u41 - l42 * u42 - l43 * u43;
    double i4 = 1.0 / d4;
    double u54 = W[og + 5][t + 4] - l40 * u50 - l41 * u51 - l42 * u52 - l43 * u53;
    double l54 = u54 * i4;
    double d5 = W[og + 5][t + 5] - l50 * u50 - l51 * u51 - l52 * u52 - l53 * u53 - l54 * u54;
    double smallest = smaller(smaller(smaller(d0, d1), smaller(d2, d3)), smaller(d4, d5));
    if (!(smallest > TINY)) {
        return 0.0;
    }
    W[og][0] = i0;
    W[og + 1][0] = l10;
    W[og + 1][1] = i1;
    W[og + 2][0] = l20;
    W[og + 2][1] = l21;
    W[og + 2][2] = i2;
    W[og + 3][0] = l30;
    W[og + 3][1] = l31;
    W[og + 3][2] = l32;
    W[og + 3][3] = i3;
    W[og + 4][0] = l40;
    W[og + 4][1] = l41;
    W[og + 4][2] = l42;
    W[og + 4][3] = l43;
    W[og + 4][4] = i4;
    W[og + 5][0] = l50;
    W[og + 5][1] = l51;
    W[og + 5][2] = l52;
    W[og + 5][3] = l53;
    W[og + 5][4] = l54;
    W[og + 5][5] = 1.0 / d5;
    return smallest;
}

/* What the present correction adds to the residual: J times it. */
static void expand(matrix W, int n, int oj, int og, int rows)
{
    int r = 0;
    for (int r_at = 0; r_at < 6; r_at++) {
        r = r_at;
        W[og + r][ADDED] = 0.0;
    }
    for (int j = oj; j < oj + n; j++) {
        double g = W[j][COMMAND] - W[j][WANTED];
        for (int r_at = 0; r_at < rows; r_at++) {
            r = r_at;
            W[og + r][ADDED] += W[j][COLUMN + r] * g;
        }
    }
}

/* Add amount to the diagonal of J J' in the rows from first to before last. */
static void damp(matrix W, int og, int first, int last, double amount)
{
    for (int r = first; r < last; r++) {
        W[og + r][MATRIX + r] += amount;
    }
}

/* How far, squared, a radian of the joints rotates the tool in its weakest direction while the point stands still. It
 * is 1 / trace(S⁻¹) of the Schur complement S of the position rows,
 * from the factor: the square of the smallest singular value where that is far smaller than the others,
 * else up to three times less. */
static double leverage(matrix W, int og)
{
    double a = W[og + 4][3];
    double b = W[og + 5][3];
    double c = W[og + 5][4];
    double e = a * c - b;
    return 1.0 / (W[og + 3][3] + W[og + 4][4] * (a * a + 1.0) + W[og + 5][5] * (e * e + c * c + 1.0));
}

/* Multipliers of the right-hand side by the factor. */
static void solve_factored(matrix W, int og)
{
    int a = og;
    int b = og + 1;
    int c = og + 2;
    int d = og + 3;
    int e = og + 4;
    int f = og + 5;
    double y0 = W[a][RIGHT];
    double y1 = W[b][RIGHT] - W[b][0] * y0;
    double y2 = W[c][RIGHT] - W[c][0] * y0 - W[c][1] * y1;
    double y3 = W[d][RIGHT] - W[d][0] * y0 - W[d][1] * y1 - W[d][2] * y2;
    double y4 = W[e][RIGHT] - W[e][0] * y0 - W[e][1] * y1 - W[e][2] * y2 - W[e][3] * y3;
    double y5 = W[f][RIGHT] - W[f][0] * y0 - W[f][1] * y1 - W[f][2] * y2 - W[f][3] * y3 - W[f][4] * y4;
    y5 = y5 * W[f][5];
    y4 = y4 * W[e][4] - W[f][4] * y5;
    y3 = y3 * W[d][3] - W[e][3] * y4 - W[f][3] * y5;
    y2 = y2 * W[c][2] - W[d][2] * y3 - W[e][2] * y4 - W[f][2] * y5;
    y1 = y1 * W[b][1] - W[c][1] * y2 - W[d][1] * y3 - W[e][1] * y4 - W[f][1] * y5;
    y0 = y0 * W[a][0] - W[b][0] * y1 - W[c][0] * y2 - W[d][0] * y3 - W[e][0] * y4 - W[f][0] * y5;
    const double each_y[] = {y0, y1, y2, y3, y4, y5};
    for (int r = 0; r < 6; r++) {
        const double y = each_y[r];
        W[og + r][MULTIPLIER] = y;
    }
}

/* Multipliers (3,) of the position rows alone, of J J' in the task rows plus floor on its diagonal. */
static tuple3 solve_point(matrix W, int og, double e0, double e1, double e2, double floor)
{
    int t = MATRIX;
    double i0 = 1.0 / (W[og][t] + floor);
    double u10 = W[og + 1][t];
    double u20 = W[og + 2][t];
    double l10 = u10 * i0;
    double l20 = u20 * i0;
    double i1 = 1.0 / larger(W[og + 1][t + 1] + floor - l10 * u10, TINY);
    double u21 = W[og + 2][t + 1] - l20 * u10;
    double l21 = u21 * i1;
    double i2 = 1.0 / larger(W[og + 2][t + 2] + floor - l20 * u20 - l21 * u21, TINY);
    double y1 = e1 - l10 * e0;
    double y2 = (e2 - l20 * e0 - l21 * y1) * i2;
    y1 = y1 * i1 - l21 * y2;
    return (tuple3){{e0 * i0 - l10 * y1 - l20 * y2, y1, y2}};
}

/* Correction of joint row j that the multipliers ask for. */
static double joint_step(matrix W, int j, int og)
{
    return W[j][COLUMN] * W[og][MULTIPLIER] + W[j][COLUMN + 1] * W[og + 1][MULTIPLIER] + W[j][COLUMN + 2] * W[og +
        2][MULTIPLIER] + W[j][COLUMN + 3] * W[og + 3][MULTIPLIER] + W[j][COLUMN + 4] * W[og + 4][MULTIPLIER] +
        W[j][COLUMN + 5] * W[og + 5][MULTIPLIER];
}

/* Factor J J' with what damps the orientation: nothing unless the posture makes a rotation of the tool weak. d² = ¼ (h₀
 * - h)² / h₀ below the leverage h₀ is smooth in the posture, and no rotation asks the joints for more than 1.3 /
 * sqrt(h₀) times its size. Fewer than six joints cannot rotate the tool at will: then h is 0. */
static void factor_task(rows P, matrix W, int S, int n, int og, int rows)
{
    int first = (int)P.at[S][FIRST];
    if (first == rows) {
        if (factor(W, og) <= 0.0) {
            damp(W, og, 0, rows, P.at[S][SINGULAR]);
            factor(W, og);
        }
        return;
    }
    double least = P.at[S][LEVERAGE];
    double h = 0.0;
    if (n >= 6 && factor(W, og) > 0.0) {
        h = leverage(W, og);
        if (h >= least) {
            return;
        }
    }
    damp(W, og, first, rows, 0.25 * (least - h) * (least - h) / least);
    if (factor(W, og) <= 0.0) {
        damp(W, og, 0, first, P.at[S][SINGULAR]);
        factor(W, og);
    }
}

/* Length of the correction of the multipliers, and its largest part of a limit. */
static tuple2 correction_size(rows P, matrix W, int n, int oj, int og)
{
    double square = 0.0;
    double part = 0.0;
    for (int j = oj; j < oj + n; j++) {
        double step = joint_step(W, j, og);
        square += step * step;
        part = larger(part, fabs(step) / P.at[j][LARGEST]);
    }
    return (tuple2){{sqrt(square), part}};
}

/* Damping (m/rad)² of a task that asks more of the joints than their limit: 0 unless the posture makes it weak. error /
 * length is what a radian moves the task (m). The answer keeps to about the limit and fades out at the singular posture
 * itself (after Maciejewski and Klein 1988), where its sign would change. */
static double weak(rows P, int S, double error, double length, double part)
{
    if (length == 0.0) {
        return 0.0;
    }
    double gain = error / length;
    double bound = smaller(sqrt(P.at[S][WEAK]), gain * part);
    return 0.25 * larger(0.0, bound * bound - gain * gain);
}

/*  */
static void scale(matrix W, int og, int rows, double part)
{
    for (int r = 0; r < rows; r++) {
        W[og + r][MULTIPLIER] /= part;
    }
}

/* All rows are one task: damped where the posture makes it weak, else scaled down to the limit. */
static int within_whole(rows P, matrix W, int S, int n, int oj, int og, int rows)
{
    const tuple2 got1 = correction_size(P, W, n, oj, og);
    double length = got1.at[0];
    double part = got1.at[1];
    if (part <= 1.0) {
        return 0;
    }
    double error = 0.0;
    for (int r = 0; r < rows; r++) {
        error += squared(W[og + r][RIGHT]);
    }
    double amount = weak(P, S, sqrt(error), length, part);
    if (amount > 0.0) {
        damp(W, og, 0, rows, amount);
        factor(W, og);
        solve_factored(W, og);
        const tuple2 got2 = correction_size(P, W, n, oj, og);
        length = got2.at[0];
        part = got2.at[1];
        damp(W, og, 0, rows, -amount);
        factor(W, og);
    }
    if (part > 1.0) {
        scale(W, og, rows, part);
    }
    return amount > 0.0 ? DAMPED : SATURATED;
}

/* The point keeps what it needs, the rotation gets what is left; then the point is damped, then scaled down. */
static int within_point_first(rows P, matrix W, int S, int n, int oj, int og)
{
    double e0 = W[og][RIGHT];
    double e1 = W[og + 1][RIGHT];
    double e2 = W[og + 2][RIGHT];
    const tuple3 got1 = solve_point(W, og, e0, e1, e2, P.at[S][SINGULAR]);
    double y0 = got1.at[0];
    double y1 = got1.at[1];
    double y2 = got1.at[2];
    double square = 0.0;
    double part = 0.0;
    double rotation = 0.0;
    for (int j = oj; j < oj + n; j++) {
        double step = W[j][COLUMN] * y0 + W[j][COLUMN + 1] * y1 + W[j][COLUMN + 2] * y2;
        square += step * step;
        part = larger(part, fabs(step) / P.at[j][LARGEST]);
        rotation = larger(rotation, fabs(joint_step(W, j, og) - step) / P.at[j][LARGEST]);
    }
    int r = 0;
    if (part <= 1.0) {
        if (part + rotation <= 1.0) {
            return 0;
        }
        double share = (1.0 - part) / rotation;
        const double each_y[] = {y0, y1, y2};
        for (int r = 0; r < 3; r++) {
            const double y = each_y[r];
            W[og + r][MULTIPLIER] = y + share * (W[og + r][MULTIPLIER] - y);
        }
        for (int r_at = 3; r_at < 6; r_at++) {
            r = r_at;
            W[og + r][MULTIPLIER] *= share;
        }
        return DAMPED;
    }
    double amount = weak(P, S, sqrt(e0 * e0 + e1 * e1 + e2 * e2), sqrt(square), part);
    if (amount > 0.0) {
        const tuple3 got2 = solve_point(W, og, e0, e1, e2, amount);
        y0 = got2.at[0];
        y1 = got2.at[1];
        y2 = got2.at[2];
    }
    W[og][MULTIPLIER] = y0;
    W[og + 1][MULTIPLIER] = y1;
    W[og + 2][MULTIPLIER] = y2;
    for (int r_at = 3; r_at < 6; r_at++) {
        r = r_at;
        W[og + r][MULTIPLIER] = 0.0;
    }
    const tuple2 got3 = correction_size(P, W, n, oj, og);
    part = got3.at[1];
    if (part > 1.0) {
        scale(W, og, 3, part);
    }
    return amount > 0.0 ? DAMPED : SATURATED;
}

/* Multipliers of the correction, within its limits; returns the flags. */
static int aim_of(rows P, matrix W, int S, int n, int oj, int og, int rows)
{
    int flags = 0;
    int r = 0;
    for (int r_at = 0; r_at < 6; r_at++) {
        r = r_at;
        W[og + r][RIGHT] = W[og + r][ERROR] + W[og + r][ADDED];
    }
    double far = sqrt(squared(W[og][RIGHT]) + squared(W[og + 1][RIGHT]) + squared(W[og + 2][RIGHT]));
    if (far > P.at[S][FARTHEST]) {
        flags = SATURATED;
        for (int r_at = 0; r_at < 3; r_at++) {
            r = r_at;
            W[og + r][RIGHT] *= P.at[S][FARTHEST] / far;
        }
    }
    solve_factored(W, og);
    double least = INFINITY;
    double square = 0.0;
    for (int j = oj; j < oj + n; j++) {
        least = smaller(least, P.at[j][LARGEST]);
        square += squared(joint_step(W, j, og));
    }
    /* Point and rotation move the joints at right angles, so half the square leaves room for both. */
    if (2.0 * square <= least * least) {
        return flags;
    }
    if ((int)P.at[S][FIRST] == rows) {
        return flags | within_whole(P, W, S, n, oj, og, rows);
    }
    return flags | within_point_first(P, W, S, n, oj, og);
}

/* ---- correct/inverse ------------------------------------------------------------------------------------- */

enum {
    SIGN_ROUNDS = 4, NEWTON_ROUNDS = 6, WAYPOINTS = 16
};
#define SETTLED_RAD 1e-07
#define GUESS_STEP 10.0
#define WAY_STEP 1e-06

/* Weighted task rows of the identified Jacobian by joint, column r of the joint rows (rotations in the tool frame). A
 * joint that is left as it is has no column, so that no step moves it. */
static void jacobian(rows P, matrix W, int S, tuple12 T, int n, int m, int oj, int rows)
{
    int r = 0;
    for (int i = 0; i < n; i++) {
        for (int r_at = 0; r_at < 6; r_at++) {
            r = r_at;
            W[oj + i][COLUMN + r] = 0.0;
        }
    }
    double weight = P.at[S][WEIGHT + 3];
    double v0 = 0.0;
    double v1 = 0.0;
    double v2 = 0.0;
    for (int k = 0; k < m; k++) {
        int j = oj + (int)P.at[k][JOINT];
        double ratio = P.at[k][RATIO] * P.at[j][FREE];
        double z0 = W[k][LINE];
        double z1 = W[k][LINE + 1];
        double z2 = W[k][LINE + 2];
        if (P.at[k][KIND] == 0.0) {
            const tuple3 got1 = cross(z0, z1, z2, T.at[9] - W[k][LINE + 3], T.at[10] - W[k][LINE + 4],
                T.at[11] - W[k][LINE + 5]);
            v0 = got1.at[0];
            v1 = got1.at[1];
            v2 = got1.at[2];
            if (rows > 3) {
                double rotation = ratio * weight;
                W[j][COLUMN + 3] += rotation * (T.at[0] * z0 + T.at[3] * z1 + T.at[6] * z2);
                W[j][COLUMN + 4] += rotation * (T.at[1] * z0 + T.at[4] * z1 + T.at[7] * z2);
                if (rows > 5) {
                    W[j][COLUMN + 5] += rotation * (T.at[2] * z0 + T.at[5] * z1 + T.at[8] * z2);
                }
            }
        } else {
            v0 = z0;
            v1 = z1;
            v2 = z2;
        }
        const double each_v[] = {v0, v1, v2};
        for (int r = 0; r < 3; r++) {
            const double v = each_v[r];
            W[j][COLUMN + r] += ratio * v;
        }
    }
}

/* Weighted task errors into the task rows; returns the distance of the tool points by axis. */
static tuple3 residual(rows P, matrix W, int S, int og, int rows, tuple12 wanted, tuple12 actual)
{
    double d0 = wanted.at[9] - actual.at[9];
    double d1 = wanted.at[10] - actual.at[10];
    double d2 = wanted.at[11] - actual.at[11];
    W[og][ERROR] = d0;
    W[og + 1][ERROR] = d1;
    W[og + 2][ERROR] = d2;
    if (rows > 3) {
        const tuple3 got1 = rotation_between(actual, wanted);
        double t0 = got1.at[0];
        double t1 = got1.at[1];
        double t2 = got1.at[2];
        W[og + 3][ERROR] = P.at[S][WEIGHT + 3] * t0;
        W[og + 4][ERROR] = P.at[S][WEIGHT + 3] * t1;
        if (rows > 5) {
            W[og + 5][ERROR] = P.at[S][WEIGHT + 3] * t2;
        }
    }
    return (tuple3){{d0, d1, d2}};
}

/* Commands from the multipliers, or a share of the way there; returns the largest change of a joint. */
static double command(matrix W, int n, int oj, int og, double share)
{
    double largest = 0.0;
    for (int j = oj; j < oj + n; j++) {
        W[j][STEPPED] = share * (W[j][WANTED] + joint_step(W, j, og) - W[j][COMMAND]);
        largest = larger(largest, fabs(W[j][STEPPED]));
        W[j][COMMAND] += W[j][STEPPED];
    }
    return largest;
}

/* Load moments at the frames now in W, then where these loads leave the arm with backlash and clearance in their
 * middle. */
static void loads_where_it_hangs(rows P, matrix W, int S, int n, int m, int oj, bool dynamic)
{
    load_moments(P, W, S, m, oj, dynamic, 0);
    for (int _ = 0; _ < (int)P.at[S][HANGING]; _++) {
        deflections(P, W, n, m, oj, false);
        hanging_frames(P, W, (int)P.at[S][LOAD_CHAIN], m, oj);
        load_moments(P, W, S, m, oj, dynamic, BEHIND_TWIST);
    }
}

/* What every joint adds with the sides now in W, and the loads where that leaves the arm. */
static void settle_on_sides(rows P, matrix W, int S, int n, int m, int oj, bool dynamic)
{
    deflections(P, W, n, m, oj, true);
    for (int _ = 0; _ < (int)P.at[S][HANGING_SIDED]; _++) {
        hanging_frames(P, W, (int)P.at[S][LOAD_CHAIN], m, oj);
        load_moments(P, W, S, m, oj, dynamic, BEHIND_TWIST);
        deflections(P, W, n, m, oj, true);
    }
}

/* Start the search at the wanted joints plus the guess. */
static void prepare(rows P, matrix W, int n, int m, int oj)
{
    int k = 0;
    for (int i = 0; i < n; i++) {
        W[oj + i][COMMAND] = W[oj + i][WANTED] + W[oj + i][GUESSED];
        for (int k_at = 0; k_at < 3; k_at++) {
            k = k_at;
            W[oj + i][MOMENT + k] = 0.0;
        }
    }
    for (int k_at = 0; k_at < m; k_at++) {
        k = k_at;
        if (P.at[k][KIND] == 0.0) {
            const tuple2 got1 = sine_cosine(P.at[k][RATIO] * W[oj + (int)P.at[k][JOINT]][WANTED]);
            double s = got1.at[0];
            double c = got1.at[1];
            W[k][SINE] = s;
            W[k][COSINE] = c;
        }
    }
}

/* What is left after the last step of the search, which was small: its Jacobian tells the step's share. */
static void left_after_step(rows P, matrix W, int S, double *info, int n, int oj, int rows, tuple3 d, tuple3 rotation)
{
    double square = 0.0;
    for (int r = 0; r < 6; r++) {
        double step = 0.0;
        if (r < rows) {
            for (int j = oj; j < oj + n; j++) {
                step += W[j][COLUMN + r] * W[j][STEPPED];
            }
        }
        if (r < 3) {
            info[LEFT + r] = step - d.at[r];
        } else {
            double rest = rotation.at[r - 3] - step / P.at[S][WEIGHT + 3];
            square += rest * rest;
        }
    }
    info[LEFT_TURN] = sqrt(square);
}

/* What is left of the tool's error at the commands in W, evaluated there; own: by the signs of the version itself. */
static void evaluate_remaining_error(rows P, matrix W, int S, double *info, int n, int m, int oj, bool dynamic,
    tuple12 wanted, bool own)
{
    int at = (int)P.at[S][LOAD_CHAIN];
    if (P.at[S][LOADED] != 0.0) {
        load_frames(P, W, at, m, oj);
        loads_where_it_hangs(P, W, S, n, m, oj, dynamic);
    }
    if (own) {
        own_signs(P, W, n, oj);
    }
    settle_on_sides(P, W, S, n, m, oj, dynamic);
    if (own) {
        kept_signs(W, n, oj);
    }
    tuple12 actual = identified_tool(P, W, m, oj);
    for (int r = 0; r < 3; r++) {
        info[LEFT + r] = actual.at[9 + r] - wanted.at[9 + r];
    }
    const tuple3 got1 = rotation_between(actual, wanted);
    double x = got1.at[0];
    double y = got1.at[1];
    double z = got1.at[2];
    info[LEFT_TURN] = sqrt(x * x + y * y + z * z);
}

/* What is left of the point's error (3,) with a share of the correction in W. */
static tuple3 left_on_way(rows P, matrix W, int S, double *info, int n, int m, bool dynamic, tuple12 wanted,
    double share)
{
    int oj = m + 1;
    for (int j = oj; j < oj + n; j++) {
        W[j][COMMAND] = W[j][WANTED] + share * W[j][STEPPED];
    }
    evaluate_remaining_error(P, W, S, info, n, m, oj, dynamic, wanted, false);
    return (tuple3){{info[LEFT], info[LEFT + 1], info[LEFT + 2]}};
}

/* Squared distance of the point on the parabola through its places with none, half and the whole of a correction. */
static double square_of(double share, tuple3 none, tuple3 half, tuple3 whole)
{
    double total = 0.0;
    for (int r = 0; r < 3; r++) {
        double a = none.at[r];
        double b = half.at[r];
        double c = whole.at[r];
        double e = a + share * (4.0 * b - 3.0 * a - c + share * 2.0 * (a - 2.0 * b + c));
        total += e * e;
    }
    return total;
}

/* Of a correction that does not reach, keep the share that brings the point closest: its way may bend past that. Near a
 * stretched elbow the whole of it can leave more than none. Returns the share. */
static double shorten(rows P, matrix W, int S, double *info, int n, int m, bool dynamic, tuple12 wanted)
{
    if (sqrt(squared(info[LEFT]) + squared(info[LEFT + 1]) + squared(info[LEFT + 2])) <= P.at[S][REACHED]) {
        return 1.0;
    }
    int oj = m + 1;
    for (int j = oj; j < oj + n; j++) {
        W[j][STEPPED] = W[j][COMMAND] - W[j][WANTED];
    }
    tuple3 none = left_on_way(P, W, S, info, n, m, dynamic, wanted, 0.0);
    tuple3 half = left_on_way(P, W, S, info, n, m, dynamic, wanted, 0.5);
    tuple3 whole = left_on_way(P, W, S, info, n, m, dynamic, wanted, 1.0);
    double at = 1.0;
    double least = square_of(1.0, none, half, whole);
    for (int k = 0; k < WAYPOINTS; k++) {
        double square = square_of((double)k / WAYPOINTS, none, half, whole);
        if (square < least) {
            at = (double)k / WAYPOINTS;
            least = square;
        }
    }
    double low = larger(0.0, at - 1.0 / WAYPOINTS);
    double high = smaller(1.0, at + 1.0 / WAYPOINTS);
    while (high - low > WAY_STEP) {
        double a = low + (high - low) / 3.0;
        double b = high - (high - low) / 3.0;
        if (square_of(a, none, half, whole) < square_of(b, none, half, whole)) {
            high = b;
        } else {
            low = a;
        }
    }
    if (high == 1.0) {
        return 1.0;
    }
    left_on_way(P, W, S, info, n, m, dynamic, wanted, high);
    return high;
}

/* Residual of the tool point and of the first task; returns the flags of what is left. */
static int report(rows P, matrix W, int S, double *info, int n, int oj, int og, int rows)
{
    (void)oj;
    int first = (int)P.at[S][FIRST];
    double total = 0.0;
    info[2] = sqrt(squared(info[LEFT]) + squared(info[LEFT + 1]) + squared(info[LEFT + 2]));
    for (int r = 0; r < first; r++) {
        total += W[og + r][ERROR] * W[og + r][ERROR];
    }
    info[3] = first > 3 ? sqrt(total) : info[2];
    int flags = info[3] <= P.at[S][REACHED] ? 0 : RESIDUAL;
    if (first < rows && n >= 6 && info[LEFT_TURN] > P.at[S][TURNED]) {
        flags |= DAMPED;
    }
    return flags;
}

/* Find the command whose identified pose is the wanted one, in at most rounds; leaves it in W, returns the flags. */
static int solve(rows P, matrix W, matrix state, double *info, int n, int m, bool dynamic, double dt, bool warm,
    int rounds)
{
    int oj = m + 1;
    int og = m + 1 + n;
    int S = P.count - 1;
    int rows = (int)P.at[S][ROWS];
    int at = (int)P.at[S][LOAD_CHAIN];
    int flags = dynamic ? DYNAMIC : 0;
    bool loaded = P.at[S][LOADED] != 0.0;
    int signs = 0;
    double largest = INFINITY;
    int made = 0;
    prepare(P, W, n, m, oj);
    tuple12 wanted = load_frames(P, W, at, m, oj);
    if (warm || at > 0) {
        wanted = wanted_tool(P, W, m, oj, false);
    }
    int it = 0;
    tuple12 actual = {{0.0}};
    tuple3 d = {{0.0}};
    for (int it_at = 0; it_at < rounds; it_at++) {
        it = it_at;
        if (it == 0 || (loaded && largest > SETTLED_RAD)) {
            if (it > 0) {
                load_frames(P, W, at, m, oj);
            }
            if (loaded) {
                loads_where_it_hangs(P, W, S, n, m, oj, dynamic);
            }
            if (it < SIGN_ROUNDS) {
                signs = sign_effects(P, W, state, n, oj, dt);
            }
            settle_on_sides(P, W, S, n, m, oj, dynamic);
        } else if (P.at[S][CURVES] != 0.0) {
            deflections(P, W, n, m, oj, true);
        }
        actual = identified_tool(P, W, m, oj);
        d = residual(P, W, S, og, rows, wanted, actual);
        if (it == 0 || largest > SETTLED_RAD) {
            jacobian(P, W, S, actual, n, m, oj, rows);
            normal_matrix(W, n, oj, og, rows);
            factor_task(P, W, S, n, og, rows);
        } else {
            expand(W, n, oj, og, rows);
        }
        if (it == 0) {
            for (int i = 0; i < 3; i++) {
                info[REMOVED + i] = W[og + i][ERROR] + W[og + i][ADDED];
            }
        }
        made = aim_of(P, W, S, n, oj, og, rows);
        double before = largest;
        largest = command(W, n, oj, og, it < NEWTON_ROUNDS ? 1.0 : 0.5);
        info[7] = it + 1.0;
        /* Steps shrink by a constant factor: the next one would be largest * largest / before. */
        if (largest < P.at[S][STEP] * (warm && it == 0 ? GUESS_STEP : 1.0) || (it > 0 && largest < before && largest *
            largest < 0.1 * P.at[S][STEP] * before)) {
            break;
        }
    }
    if (it + 1 < rounds) {
        left_after_step(P, W, S, info, n, oj, rows, d, rotation_between(actual, wanted));
    } else {
        evaluate_remaining_error(P, W, S, info, n, m, oj, dynamic, wanted, false);
    }
    if (made & (SATURATED | DAMPED)) {
        shorten(P, W, S, info, n, m, dynamic, wanted);
    }
    return flags | made | signs | report(P, W, S, info, n, oj, og, rows);
}

/* ---- correct/rates --------------------------------------------------------------------------------------- */

#define SLOWED_BY 1e-06
#define CAUGHT_UP 1e-10
#define BRAKE 0.9
#define MOST_BRAKE 10.0
#define THERE 1e-12

/* The most rate at which a joint that goes the way of rate can still stop at the limit of its correction. In steps:
 * from n times the change of rate of one step, n in k to k + 1, it stops after (k + 1) n - k (k + 1) / 2 of them. */
static double room_of(rows P, matrix state, int i, int j, double rate, double dt)
{
    double spurt = BRAKE * P.at[j][SPURT] * dt;
    double room = (larger(0.0, P.at[j][LARGEST] - copysign(1.0, rate) * state[i][LAST_DELTA]) + THERE) / (spurt * dt);
    double k = floor(sqrt(0.25 + 2.0 * room) - 0.5);
    return spurt * (room + 0.5 * k * (k + 1.0)) / (k + 1.0);
}

/* Next place of all joints on the way to column aim of W, which was at column before of the state,
 * into NEXT. The way that is behind is made up no faster than the joints can brake,
 * so they do not swing beyond. Changes of rate are scaled by one factor for all joints,
 * as are rates. stops: no joint comes faster than it can stop at its limit. */
static void toward(rows P, matrix W, matrix state, int n, int oj, int aim, int before, double share, double dt,
    bool fresh, bool stops)
{
    double late = 0.0;
    double fast = 1.0;
    double sudden = 1.0;
    int i = 0;
    int j = 0;
    for (int i_at = 0; i_at < n; i_at++) {
        i = i_at;
        j = oj + i;
        W[j][NEXT] = fresh ? 0.0 : state[i][before] - state[i][LAST_DELTA];
        late = larger(late, fabs(W[j][NEXT]) / (share * P.at[j][SPURT]));
    }
    /* In a time of 1 / close, what is behind would be made up. */
    double close = late > 0.0 ? smaller(1.0 / dt, (sqrt(0.25 * dt * dt + 2.0 * late) - 0.5 * dt) / late) : 0.0;
    double room = 0.0;
    for (int i_at = 0; i_at < n; i_at++) {
        i = i_at;
        j = oj + i;
        double was = fresh ? state[i][LAST_DELTA] : state[i][before];
        W[j][WISH] = (W[j][aim] - was) / dt + W[j][NEXT] * close;
        fast = larger(fast, fabs(W[j][WISH]) / (share * P.at[j][CHANGE]));
        if (stops) {
            room = room_of(P, state, i, j, W[j][WISH], dt);
            if (fabs(W[j][WISH]) > room) {
                fast = larger(fast, smaller(MOST_BRAKE, fabs(W[j][WISH]) / room));
            }
        }
    }
    for (int i_at = 0; i_at < n; i_at++) {
        i = i_at;
        j = oj + i;
        W[j][WISH] = W[j][WISH] / fast - state[i][VELOCITY];
        sudden = larger(sudden, fabs(W[j][WISH]) / (share * P.at[j][SPURT] * dt));
    }
    for (int i_at = 0; i_at < n; i_at++) {
        i = i_at;
        j = oj + i;
        double rate = state[i][VELOCITY] + W[j][WISH] / sudden;
        if (stops) {
            room = room_of(P, state, i, j, rate, dt);
            /* on the way to a limit the acceleration of another joint may hold back its braking */
            if (fabs(rate) > room) {
                double spurt = P.at[j][SPURT] * dt;
                double slower = larger(room, fabs(state[i][VELOCITY]) - spurt);
                rate = copysign(smaller(fabs(rate), slower), rate);
            }
        }
        W[j][NEXT] = state[i][LAST_DELTA] + rate * dt;
    }
}

/* Whether the wanted correction itself keeps to the bounds. */
static bool keeps_up(rows P, matrix W, matrix state, int n, int oj, double dt)
{
    if (state[n][BEHIND] != 0.0) {
        return false;
    }
    /* before its second setpoint a stream has no rate that could change */
    bool moving = state[n][STARTED] > 1.0;
    for (int i = 0; i < n; i++) {
        int j = oj + i;
        double step = W[j][TOTAL] - state[i][LAST_DELTA];
        if (!(fabs(step) <= P.at[j][CHANGE] * dt)) {
            return false;
        }
        /* Far from the limit, which is mostly so, this needs no root. */
        double spurt = BRAKE * P.at[j][SPURT] * dt * dt;
        double room = P.at[j][LARGEST] - copysign(1.0, step) * state[i][LAST_DELTA];
        if (!(squared(fabs(step) + 0.5 * spurt) <= 2.0 * spurt * room) && fabs(step) > dt * room_of(P, state, i, j,
            step, dt)) {
            return false;
        }
        if (moving && !(fabs(step - state[i][VELOCITY] * dt) <= P.at[j][SPURT] * dt * dt)) {
            return false;
        }
    }
    return true;
}

/* Take back from the aim what the tool point is off there, beside what the search left: the rotation is not quite
 * small. */
static void hold_point(rows P, matrix W, int S, double *info, int n, int m, bool dynamic, tuple12 wanted)
{
    int oj = m + 1;
    int og = m + 1 + n;
    double l0 = info[LEFT];
    double l1 = info[LEFT + 1];
    double l2 = info[LEFT + 2];
    int j = 0;
    for (int j_at = oj; j_at < oj + n; j_at++) {
        j = j_at;
        W[j][COMMAND] = W[j][WANTED] + W[j][AIMED];
    }
    evaluate_remaining_error(P, W, S, info, n, m, oj, dynamic, wanted, false);
    /* Near a singular posture of the point this would ask for too much. */
    double floor = 0.01 * P.at[S][WEAK];
    const tuple3 got1 = solve_point(W, og, info[LEFT] - l0, info[LEFT + 1] - l1, info[LEFT + 2] - l2, floor);
    double y0 = got1.at[0];
    double y1 = got1.at[1];
    double y2 = got1.at[2];
    for (int j_at = oj; j_at < oj + n; j_at++) {
        j = j_at;
        W[j][COMMAND] = W[j][WANTED] + W[j][TOTAL];
        W[j][AIMED] -= W[j][COLUMN] * y0 + W[j][COLUMN + 1] * y1 + W[j][COLUMN + 2] * y2;
    }
}

/* Bound the change of the whole correction, from wanted in W to answered; by how much it falls behind. */
static double bound_change(rows P, matrix W, int S, matrix state, double *info, int n, int m, bool dynamic, double dt,
    bool fresh, bool ramping)
{
    int oj = m + 1;
    int og = m + 1 + n;
    int j = 0;
    if (keeps_up(P, W, state, n, oj, dt)) {
        for (int j_at = oj; j_at < oj + n; j_at++) {
            j = j_at;
            W[j][AIMED] = W[j][NEXT] = W[j][TOTAL];
        }
        return 0.0;
    }
    toward(P, W, state, n, oj, TOTAL, TARGET, 0.5, dt, fresh, false);
    double g0 = 0.0;
    double g1 = 0.0;
    double g2 = 0.0;
    g0 = g1 = g2 = 0.0;
    for (int j_at = oj; j_at < oj + n; j_at++) {
        j = j_at;
        double behind = W[j][TOTAL] - W[j][NEXT];
        g0 = g0 + W[j][COLUMN] * behind;
        g1 = g1 + W[j][COLUMN + 1] * behind;
        g2 = g2 + W[j][COLUMN + 2] * behind;
    }
    const tuple3 got1 = solve_point(W, og, g0, g1, g2, P.at[S][SINGULAR]);
    double y0 = got1.at[0];
    double y1 = got1.at[1];
    double y2 = got1.at[2];
    for (int j_at = oj; j_at < oj + n; j_at++) {
        j = j_at;
        W[j][AIMED] = W[j][NEXT] + W[j][COLUMN] * y0 + W[j][COLUMN + 1] * y1 + W[j][COLUMN + 2] * y2;
    }
    if (!ramping) {
        hold_point(P, W, S, info, n, m, dynamic, wanted_tool(P, W, m, oj, false));
    }
    for (int j_at = oj; j_at < oj + n; j_at++) {
        j = j_at;
        W[j][AIMED] = smaller(larger(W[j][AIMED], -P.at[j][LARGEST]), P.at[j][LARGEST]);
    }
    toward(P, W, state, n, oj, AIMED, AIMED, 1.0, dt, fresh, true);
    double most = 0.0;
    for (int j_at = oj; j_at < oj + n; j_at++) {
        j = j_at;
        most = larger(most, fabs(W[j][TOTAL] - W[j][NEXT]));
    }
    return most;
}

/* ---- correct/stream -------------------------------------------------------------------------------------- */

#define NONSENSE 1000.0
#define LOOK_AHEAD_S 0.05
#define LOOK_AHEAD_RAD 0.001
#define JITTER_S 0.001
#define LEAST_STEP_S 1e-06

/* Status of a setpoint before anything is computed: numbers, limits, speed. */
static int setpoint_status(rows P, matrix state, double *info, const double *x, int n, int m, int width, double dt)
{
    int i = 0;
    for (int i_at = 0; i_at < n * width; i_at++) {
        i = i_at;
        if (!(fabs(x[i]) < INFINITY)) {
            return NOT_FINITE;
        }
    }
    int mask = 0;
    for (int i_at = 0; i_at < n; i_at++) {
        i = i_at;
        if (!(P.at[m + 1 + i][LOWER] <= x[i] && x[i] <= P.at[m + 1 + i][UPPER])) {
            mask |= 1 << i;
        }
    }
    if (mask != 0) {
        info[1] = mask;
        return JOINT_LIMIT;
    }
    if (state[n][STARTED] != 0.0) {
        for (int i_at = 0; i_at < n; i_at++) {
            i = i_at;
            if (fabs(x[i] - state[i][LAST_Q]) > P.at[m + 1 + i][SPEED] * larger(dt, JITTER_S)) {
                mask |= 1 << i;
            }
        }
    }
    info[1] = mask;
    return mask != 0 ? RATE_LIMIT : OK;
}

/* Direction of the last motion of a joint: it reverses when the joint comes back by more than the band. */
static void direction_of(matrix state, matrix W, int j, int i, double x, double band, bool started)
{
    double sign = started ? state[i][LAST_SIGN] : 0.0;
    double place = started ? state[i][REVERSED_AT] : x;
    if (x > place + band || (sign > 0.0 && x > place)) {
        sign = 1.0;
        place = x;
    } else if (x < place - band || (sign < 0.0 && x < place)) {
        sign = -1.0;
        place = x;
    }
    W[j][SIGN] = sign;
    W[j][REVERSED_AT_NEW] = place;
}

/* Speed and acceleration of a joint by a critically damped filter that looks back only; it lags by 2 / omega. */
static void smooth(matrix state, matrix W, int j, int i, double x, double omega, double dt, bool started)
{
    double place = started ? state[i][SMOOTH] : x;
    double speed = started ? state[i][SMOOTH_SPEED] : 0.0;
    double step = smaller(dt, 0.1);
    double new = (speed + step * omega * omega * (x - place)) / (1.0 + 2.0 * omega * step + squared(omega * step));
    W[j][SPEED_NOW] = new;
    W[j][ACCEL_NOW] = step > 0.0 ? (new - speed) / step : 0.0;
    W[j][SMOOTH_NEW] = place + step * new;
    W[j][SMOOTH_SPEED_NEW] = new;
}

/* Wanted joints, speeds, accelerations and directions into W; whether the load is dynamic. */
static bool motion(rows P, matrix W, matrix state, const double *x, int n, int m, int width, double dt)
{
    int S = P.count - 1;
    bool started = state[n][STARTED] != 0.0;
    double omega = P.at[S][FILTER];
    for (int i = 0; i < n; i++) {
        int j = m + 1 + i;
        W[j][WANTED] = x[i];
        direction_of(state, W, j, i, x[i], P.at[S][HYSTERESIS], started);
        if (omega > 0.0) {
            smooth(state, W, j, i, x[i], omega, dt, started);
        }
        if (width == 3) {
            W[j][SPEED_NOW] = x[n + i];
            W[j][ACCEL_NOW] = x[2 * n + i];
        } else if (omega <= 0.0) {
            W[j][SPEED_NOW] = 0.0;
            W[j][ACCEL_NOW] = 0.0;
        }
    }
    return width == 3 || omega > 0.0;
}

/* Advance the ramp from the last version, or from no correction; returns the part that remains,
 * and its length. The whole correction goes into W. It is eased in and out,
 * so its rate is at most 1.5 times that of a straight ramp. */
static tuple2 ramp(rows P, matrix W, matrix state, int n, int m, double dt)
{
    int S = P.count - 1;
    double length = state[n][LENGTH];
    int j = 0;
    double remaining = 0.0;
    if (state[n][REBASE] != 0.0) {
        length = P.at[S][RAMP];
        for (int i = 0; i < n; i++) {
            j = m + 1 + i;
            W[j][RAMPED] = state[i][LAST_DELTA] - (W[j][COMMAND] - W[j][WANTED]);
            length = larger(length, 1.5 * fabs(W[j][RAMPED]) / P.at[j][RATE]);
        }
        remaining = 1.0;
    } else {
        for (int i = 0; i < n; i++) {
            W[m + 1 + i][RAMPED] = state[i][OFFSET];
        }
        remaining = length > 0.0 ? larger(0.0, state[n][REMAINING] - dt / length) : 0.0;
    }
    double share = remaining * remaining * (3.0 - 2.0 * remaining);
    for (int j_at = m + 1; j_at < m + 1 + n; j_at++) {
        j = j_at;
        W[j][TOTAL] = W[j][COMMAND] - W[j][WANTED] + share * W[j][RAMPED];
    }
    return (tuple2){{remaining, length}};
}

/* Return the flag UNSURE where the wanted joints are in a box of doubt, else 0. */
static int flag_doubts(rows P, matrix W, int S, int n, int m)
{
    int first = (int)P.at[S][DOUBT_AT];
    double bounded = smaller(n, HIGHEST_OF_BOX - LOWEST_OF_BOX);
    for (int row = first; row < first + (int)P.at[S][DOUBTS]; row++) {
        int inside = 1;
        for (int i = 0; i < bounded; i++) {
            double wanted = W[m + 1 + i][WANTED];
            if (!(P.at[row][LOWEST_OF_BOX + i] <= wanted && wanted <= P.at[row][HIGHEST_OF_BOX + i])) {
                inside = 0;
            }
        }
        if (inside != 0) {
            return UNSURE;
        }
    }
    return 0;
}

/* Corrected joints into out within the limits of correction and joints,
 * and what was held at them into the info. A correction that exceeds a limit is scaled in all joints by one factor,
 * so that the tool stays between where it is with and without it. Returns the status: where the options refuse what
 * exceeds a limit, it is not OK, and never for a correction that is not finite or that no arm has. */
static int verdict(rows P, matrix W, double *info, double *out, int flags, int n, int m)
{
    int S = P.count - 1;
    int large = 0;
    int outside = 0;
    double share = 1.0;
    double size = 0.0;
    flags |= flag_doubts(P, W, S, n, m);
    for (int k = 0; k < 3; k++) {
        size += fabs(info[REMOVED + k]) + fabs(info[LEFT + k]);
    }
    int i = 0;
    for (int i_at = 0; i_at < n; i_at++) {
        i = i_at;
        size += fabs(W[m + 1 + i][NEXT]);
    }
    if (!(size < NONSENSE)) {
        info[0] = flags;
        return TOO_LARGE;
    }
    int j = 0;
    for (int i_at = 0; i_at < n; i_at++) {
        i = i_at;
        j = m + 1 + i;
        double delta = W[j][NEXT];
        if (!(fabs(delta) < P.at[j][LARGEST] * (1.0 - 1e-09))) {
            large |= 1 << i;
            if (fabs(delta) > P.at[j][LARGEST] * (1.0 + 1e-09)) {
                flags |= SATURATED;
                share = smaller(share, P.at[j][LARGEST] / fabs(delta));
            }
        }
        if (!(P.at[j][LOWER] <= W[j][WANTED] + delta && W[j][WANTED] + delta <= P.at[j][UPPER])) {
            outside |= 1 << i;
            double room = (delta > 0.0 ? P.at[j][UPPER] : P.at[j][LOWER]) - W[j][WANTED];
            share = delta != 0.0 ? smaller(share, larger(0.0, room / delta)) : 0.0;
        }
    }
    for (int i_at = 0; i_at < n; i_at++) {
        i = i_at;
        j = m + 1 + i;
        out[i] = smaller(larger(W[j][WANTED] + share * W[j][NEXT], P.at[j][LOWER]), P.at[j][UPPER]);
    }
    info[0] = flags | (outside != 0 ? SATURATED : 0);
    if (outside == 0 && !(flags & SATURATED)) {
        return OK;
    }
    if (P.at[S][SATURATES] != 0.0) {
        info[1] = large | outside;
        return OK;
    }
    info[1] = flags & SATURATED ? large : outside;
    return flags & SATURATED ? TOO_LARGE : JOINT_LIMIT;
}

/* Guess the correction from the last ones; whether there was anything to go by. */
static bool look_ahead(matrix W, matrix state, int n, int m, double dt, bool fresh)
{
    int i = 0;
    if (fresh) {
        for (int i_at = 0; i_at < n; i_at++) {
            i = i_at;
            W[m + 1 + i][GUESSED] = 0.0;
        }
        return false;
    }
    double ahead = dt < LOOK_AHEAD_S ? dt : 0.0;
    for (int i_at = 0; i_at < n; i_at++) {
        i = i_at;
        double step = smaller(larger(state[i][SLOPE] * ahead, -LOOK_AHEAD_RAD), LOOK_AHEAD_RAD);
        W[m + 1 + i][GUESSED] = state[i][GUESS] + step;
    }
    return true;
}

/* Remember what was answered. */
static void commit(rows P, matrix W, matrix state, double *out, double remaining, double length, double behind, int n,
    int m, double dt, bool fresh)
{
    (void)P;
    bool started = state[n][STARTED] != 0.0;
    for (int i = 0; i < n; i++) {
        int j = m + 1 + i;
        state[i][LAST_A] = W[j][TILT_A];
        state[i][LAST_B] = W[j][TILT_B];
        state[i][LAST_SIDE] = W[j][SIDE];
        state[i][LAST_Q] = W[j][WANTED];
        state[i][REVERSED_AT] = W[j][REVERSED_AT_NEW];
        state[i][LAST_SIGN] = W[j][SIGN];
        state[i][OFFSET] = remaining > 0.0 ? W[j][RAMPED] : 0.0;
        double answered = out[i] - W[j][WANTED];
        state[i][VELOCITY] = started ? (answered - state[i][LAST_DELTA]) / larger(dt, LEAST_STEP_S) : 0.0;
        state[i][LAST_DELTA] = answered;
        state[i][TARGET] = W[j][TOTAL];
        state[i][AIMED] = W[j][AIMED];
        state[i][SMOOTH] = W[j][SMOOTH_NEW];
        state[i][SMOOTH_SPEED] = W[j][SMOOTH_SPEED_NEW];
        double delta = W[j][COMMAND] - W[j][WANTED];
        state[i][SLOPE] = fresh || dt < 1e-06 ? 0.0 : (delta - state[i][GUESS]) / dt;
        state[i][GUESS] = delta;
    }
    state[n][STARTED] = started ? 2.0 : 1.0;
    state[n][REBASE] = 0.0;
    state[n][REMAINING] = remaining;
    state[n][LENGTH] = length;
    state[n][BEHIND] = behind <= CAUGHT_UP ? 0.0 : 1.0;
}

/* What is left of the tool's error at the joints that are answered, by the signs of the version itself,
 * into the info. near: a sign is softened or held to its rate, which is said where it leaves something. */
static void report_remaining_error(rows P, matrix W, int S, double *info, double *out, int n, int m, bool dynamic,
    bool near)
{
    int oj = m + 1;
    for (int i = 0; i < n; i++) {
        W[oj + i][COMMAND] = out[i];
    }
    evaluate_remaining_error(P, W, S, info, n, m, oj, dynamic, wanted_tool(P, W, m, oj, false), true);
    info[2] = sqrt(squared(info[LEFT]) + squared(info[LEFT + 1]) + squared(info[LEFT + 2]));
    if (!(info[2] <= P.at[S][REACHED])) {
        info[0] = (int)info[0] | RESIDUAL | (near ? REVERSING : 0);
    }
}

/* Go no further to a limit than brings the point closest; the joints into out. */
static void hold_short(rows P, matrix W, int S, double *info, double *out, int n, int m, bool dynamic)
{
    int oj = m + 1;
    int i = 0;
    for (int i_at = 0; i_at < n; i_at++) {
        i = i_at;
        W[oj + i][COMMAND] = out[i];
    }
    tuple12 wanted = wanted_tool(P, W, m, oj, false);
    evaluate_remaining_error(P, W, S, info, n, m, oj, dynamic, wanted, false);
    shorten(P, W, S, info, n, m, dynamic, wanted);
    for (int i_at = 0; i_at < n; i_at++) {
        i = i_at;
        out[i] = W[oj + i][COMMAND];
    }
}

/* Correct one setpoint of a stream and return its status; only status 0 leaves numbers and changes state. */
static int correct_setpoint(rows P, matrix W, matrix state, const double *x, int width, double dt, double *out,
    double *info)
{
    int S = P.count - 1;
    int n = (int)P.at[S][N];
    int m = (int)P.at[S][M];
    int i = 0;
    for (int i_at = 0; i_at < INFO; i_at++) {
        i = i_at;
        info[i] = 0.0;
    }
    for (int i_at = 0; i_at < n; i_at++) {
        i = i_at;
        out[i] = NAN;
    }
    int status = setpoint_status(P, state, info, x, n, m, width, dt);
    if (status != OK) {
        return status;
    }
    bool dynamic = motion(P, W, state, x, n, m, width, dt);
    bool fresh = state[n][STARTED] == 0.0 || state[n][REBASE] != 0.0;
    bool warm = look_ahead(W, state, n, m, dt, fresh);
    int flags = solve(P, W, state, info, n, m, dynamic, fresh ? INFINITY : dt, warm, (int)P.at[S][ITERATIONS]);
    bool near = (flags & (NEAR_REVERSAL | REVERSING)) != 0;
    flags = flags & ~NEAR_REVERSAL;
    const tuple2 got1 = ramp(P, W, state, n, m, dt);
    double remaining = got1.at[0];
    double length = got1.at[1];
    double behind = 0.0;
    if (state[n][STARTED] != 0.0) {
        double step_s = larger(dt, LEAST_STEP_S);
        behind = bound_change(P, W, S, state, info, n, m, dynamic, step_s, fresh, remaining > 0.0);
    } else {
        for (int j = m + 1; j < m + 1 + n; j++) {
            W[j][AIMED] = W[j][NEXT] = W[j][TOTAL];
        }
    }
    if (remaining > 0.0) {
        flags |= RAMPING;
    }
    if (behind > SLOWED_BY) {
        flags |= SLOWED;
    }
    status = verdict(P, W, info, out, flags, n, m);
    if (status == OK) {
        commit(P, W, state, out, remaining, length, behind, n, m, dt, fresh);
        if (remaining > 0.0 || behind > 0.0 || info[1] != 0.0 || near) {
            report_remaining_error(P, W, S, info, out, n, m, dynamic, near);
        }
    } else {
        for (int i_at = 0; i_at < n; i_at++) {
            i = i_at;
            out[i] = NAN;
        }
    }
    return status;
}

/* Correct one row that follows no other: no ramp, no rate limits; returns its status. A row too large or outside the
 * limits keeps its numbers: nothing moves by them. */
static int correct_row(rows P, matrix W, matrix state, const double *x, int width, const double *direction, double *out,
    double *info, int n, int m)
{
    int S = P.count - 1;
    int i = 0;
    for (int i_at = 0; i_at < INFO; i_at++) {
        i = i_at;
        info[i] = 0.0;
    }
    int j = 0;
    for (int i_at = 0; i_at < n; i_at++) {
        i = i_at;
        j = m + 1 + i;
        W[j][WANTED] = x[i];
        W[j][GUESSED] = 0.0;
        W[j][SIGN] = direction[i];
        W[j][SPEED_NOW] = width == 3 ? x[n + i] : 0.0;
        W[j][ACCEL_NOW] = width == 3 ? x[2 * n + i] : 0.0;
    }
    int flags = solve(P, W, state, info, n, m, width == 3, INFINITY, false, (int)P.at[S][ROUNDS]);
    bool near = (flags & NEAR_REVERSAL) != 0;
    flags = flags & ~NEAR_REVERSAL;
    for (int j_at = m + 1; j_at < m + 1 + n; j_at++) {
        j = j_at;
        W[j][NEXT] = W[j][COMMAND] - W[j][WANTED];
    }
    int status = verdict(P, W, info, out, flags, n, m);
    if (info[1] != 0.0) {
        hold_short(P, W, S, info, out, n, m, width == 3);
    }
    if (info[1] != 0.0 || near) {
        report_remaining_error(P, W, S, info, out, n, m, width == 3, near);
    }
    for (int i_at = 0; i_at < n; i_at++) {
        i = i_at;
        if (!(P.at[m + 1 + i][LOWER] <= x[i] && x[i] <= P.at[m + 1 + i][UPPER])) {
            status = JOINT_LIMIT;
        }
    }
    return status;
}

/* ---- what the outside calls ------------------------------------------------------------------------------------ */

/* Header of a program, little-endian: magic, format, bytes of the header, layout, rows, columns, joints, CRC-32 of
 * everything with these four bytes zero, number of the version, its id, the robot's name. */
enum {
    AT_FORMAT = 4, AT_HEADER = 8, AT_LAYOUT = 12, AT_ROWS = 16, AT_COLUMNS = 20, AT_JOINTS = 24, AT_CRC = 28,
    AT_NUMBER = 32, AT_VERSION = 40, AT_ROBOT = 80, VERSION_BYTES = 40, ROBOT_BYTES = 48
};

static uint32_t word(const unsigned char *at)
{
    return (uint32_t)at[0] | (uint32_t)at[1] << 8 | (uint32_t)at[2] << 16 | (uint32_t)at[3] << 24;
}

static uint64_t long_word(const unsigned char *at)
{
    return (uint64_t)word(at) | (uint64_t)word(at + 4) << 32;
}

/* CRC-32 of IEEE 802.3, as zlib has it, with four bytes taken for zero. */
static uint32_t checksum(const unsigned char *bytes, size_t count, size_t hole)
{
    uint32_t crc = 0xffffffffu;
    for (size_t i = 0; i < count; i++) {
        crc ^= i >= hole && i < hole + 4 ? 0u : bytes[i];
        for (int bit = 0; bit < 8; bit++) {
            crc = crc >> 1 ^ (0xedb88320u & (0u - (crc & 1u)));
        }
    }
    return ~crc;
}

/* Header checked; the numbers of rows and joints where it is whole. */
static int look(const unsigned char *bytes, size_t count, int *rows_found, int *joints)
{
    if (count < KC_HEADER_BYTES) {
        return KC_TRUNCATED;
    }
    if (memcmp(bytes, "KLTC", 4) != 0) {
        return KC_NOT_A_PROGRAM;
    }
    if (word(bytes + AT_FORMAT) > KC_FORMAT) {
        return KC_NEWER_FORMAT;
    }
    if (word(bytes + AT_HEADER) != KC_HEADER_BYTES) {
        return KC_NOT_A_PROGRAM;
    }
    if (word(bytes + AT_LAYOUT) != KC_LAYOUT || word(bytes + AT_COLUMNS) != KC_COLUMNS) {
        return KC_OTHER_LAYOUT;
    }
    const uint32_t found = word(bytes + AT_ROWS), n = word(bytes + AT_JOINTS);
    if (found < 4 || found > KC_MOST_ROWS || n < 1 || n > KC_MOST_JOINTS) {
        return KC_IMPOSSIBLE;
    }
    const size_t whole = KC_HEADER_BYTES + (size_t)found * KC_COLUMNS * 8;
    if (count < whole) {
        return KC_TRUNCATED;
    }
    if (count > whole) {
        return KC_NOT_A_PROGRAM;
    }
    if (checksum(bytes, count, AT_CRC) != word(bytes + AT_CRC)) {
        return KC_DAMAGED;
    }
    *rows_found = (int)found;
    *joints = (int)n;
    return 0;
}

static double number_at(const unsigned char *bytes, int row, int column)
{
    const uint64_t raw = long_word(bytes + KC_HEADER_BYTES + 8 * ((size_t)row * KC_COLUMNS + (size_t)column));
    double value = 0.0;
    memcpy(&value, &raw, sizeof value);
    return value;
}

/* Whether a number of the program is a whole one from `least` to `most`. */
static bool whole(const unsigned char *bytes, int row, int column, int least, int most)
{
    const double value = number_at(bytes, row, column);
    return value >= least && value <= most && value == floor(value);
}

/* Whether every place that the kernels go by lies within the program: then no number of it leads out of the memory. */
static bool possible(const unsigned char *bytes, int count, int n)
{
    const int s = count - 1;
    for (int row = 0; row < count; row++) {
        for (int column = 0; column < KC_COLUMNS; column++) {
            const double value = number_at(bytes, row, column);
            if (value != value) {
                return false;
            }
        }
    }
    if (!whole(bytes, s, N, n, n) || !whole(bytes, s, M, 1, KC_MOST_MOVES) ||
        !whole(bytes, s, CURVES, 0, KC_MOST_ROWS) || !whole(bytes, s, BENDINGS, 0, KC_MOST_ROWS) ||
        !whole(bytes, s, LOAD_CHAIN, 0, KC_MOST_ROWS) || !whole(bytes, s, DOUBT_AT, 0, KC_MOST_ROWS) ||
        !whole(bytes, s, DOUBTS, 0, KC_MOST_ROWS) || !whole(bytes, s, ITERATIONS, 1, KC_MOST_ROUNDS) ||
        !whole(bytes, s, ROUNDS, 1, KC_MOST_ROUNDS) || !whole(bytes, s, HANGING, 0, KC_MOST_HANGING) ||
        !whole(bytes, s, HANGING_SIDED, 0, KC_MOST_HANGING) ||
        !whole(bytes, s, ROWS, 5, 6) || !whole(bytes, s, FIRST, 3, 6) || number_at(bytes, s, FIRST) > number_at(bytes, s, ROWS)) {
        return false;
    }
    const int m = (int)number_at(bytes, s, M), curves = (int)number_at(bytes, s, CURVES);
    const int bendings = (int)number_at(bytes, s, BENDINGS), loads = (int)number_at(bytes, s, LOAD_CHAIN);
    const int mount = number_at(bytes, s, MOUNT) != 0.0 ? 1 : 0;
    const int doubts = (int)number_at(bytes, s, DOUBT_AT) + (int)number_at(bytes, s, DOUBTS);
    if (m + 1 + n + curves + 2 * bendings + mount > s || (loads != 0 && loads + m + 1 + mount > s) || doubts > s) {
        return false;
    }
    for (int k = 0; k < m; k++) {
        if (!whole(bytes, k, JOINT, 0, n - 1)) {
            return false;
        }
    }
    for (int j = m + 1; j < m + 1 + n; j++) {
        if (!(number_at(bytes, j, LARGEST) > 0.0) || !(number_at(bytes, j, RATE) > 0.0)) {
            return false;
        }
    }
    for (int row = m + 1 + n; row < m + 1 + n + curves; row++) {
        if (!whole(bytes, row, CURVED, 0, n - 1) || !whole(bytes, row, DRIVER, 0, n - 1) ||
            !whole(bytes, row, MOVED, 0, 6)) {
            return false;
        }
    }
    for (int row = m + 1 + n + curves; row < m + 1 + n + curves + 2 * bendings; row += 2) {
        if (!whole(bytes, row, BENDING_JOINT, 0, n - 1) || !whole(bytes, row, POWER, 0, 3) ||
            !whole(bytes, row, OF_AXIS, 0, 6)) {
            return false;
        }
    }
    return true;
}

/* Rows of memory behind the program: scratch, state, and one row each for joints out and info. */
static int rows_behind(int moves, int joints)
{
    return (moves + 1 + joints + 6) + (joints + 1) + 2;
}

size_t kc_memory_needed(const void *program, size_t bytes)
{
    int count = 0, n = 0;
    if (program == NULL || look(program, bytes, &count, &n) != 0 || !possible(program, count, n)) {
        return 0;
    }
    const int m = (int)number_at(program, count - 1, M);
    return (size_t)(count + rows_behind(m, n)) * KC_COLUMNS;
}

static rows program_of(const kc_corrector *c)
{
    return (rows){c->memory, c->rows};
}

static matrix scratch_of(const kc_corrector *c)
{
    return c->memory + c->rows;
}

static matrix state_of(const kc_corrector *c)
{
    return scratch_of(c) + c->moves + 1 + c->joints + 6;
}

void kc_restart(kc_corrector *corrector, int settled)
{
    if (corrector == NULL || corrector->memory == NULL) {
        return;
    }
    const matrix state = state_of(corrector);
    memset(state, 0, (size_t)(corrector->joints + 1) * sizeof *state);
    state[corrector->joints][REBASE] = settled ? 0.0 : 1.0;
}

/* Copy a text of the header, which may fill its place. */
static void copy_text(char *to, const unsigned char *from, size_t count)
{
    memcpy(to, from, count);
    to[count] = '\0';
}

int kc_load(kc_corrector *corrector, const void *program, size_t bytes, double *memory, size_t doubles,
                int settled)
{
    if (corrector == NULL || memory == NULL) {
        return KC_NO_MEMORY;
    }
    if (program == NULL) { /* as C++ gives an empty file */
        return KC_TRUNCATED;
    }
    int count = 0, n = 0;
    const int fault = look(program, bytes, &count, &n);
    if (fault != 0) {
        return fault;
    }
    if (!possible(program, count, n)) {
        return KC_IMPOSSIBLE;
    }
    const int m = (int)number_at(program, count - 1, M);
    const size_t needed = (size_t)(count + rows_behind(m, n)) * KC_COLUMNS;
    if (doubles < needed) {
        return KC_NO_MEMORY;
    }
    memset(memory, 0, needed * sizeof *memory);
    corrector->memory = (matrix)memory;
    for (int row = 0; row < count; row++) {
        for (int column = 0; column < KC_COLUMNS; column++) {
            corrector->memory[row][column] = number_at(program, row, column);
        }
    }
    corrector->rows = count;
    corrector->joints = n;
    corrector->moves = m;
    corrector->number = long_word((const unsigned char *)program + AT_NUMBER);
    copy_text(corrector->version, (const unsigned char *)program + AT_VERSION, VERSION_BYTES);
    copy_text(corrector->robot, (const unsigned char *)program + AT_ROBOT, ROBOT_BYTES);
    kc_restart(corrector, settled);
    return 0;
}

int kc_change(kc_corrector *corrector, const void *program, size_t bytes, double *memory, size_t doubles)
{
    if (corrector == NULL || corrector->memory == NULL || memory == NULL || (matrix)memory == corrector->memory) {
        return KC_NO_MEMORY;
    }
    kc_corrector next;
    const int fault = kc_load(&next, program, bytes, memory, doubles, 0);
    if (fault != 0) {
        return fault;
    }
    if (next.joints != corrector->joints || strcmp(next.robot, corrector->robot) != 0) {
        return KC_OTHER_ARM;
    }
    memcpy(state_of(&next), state_of(corrector), (size_t)(next.joints + 1) * sizeof *next.memory);
    state_of(&next)[next.joints][REBASE] = 1.0;
    *corrector = next;
    return 0;
}

/* Setpoint side by side, as the kernels take it; the number of vectors, 0 when only one of speeds and accelerations came. */
static int side_by_side(kc_corrector *c, const double *q, const double *qd, const double *qdd)
{
    const size_t size = (size_t)c->joints * sizeof *q;
    if ((qd == NULL) != (qdd == NULL) || q == NULL) {
        return 0;
    }
    memcpy(c->setpoint, q, size);
    if (qd == NULL) {
        return 1;
    }
    memcpy(c->setpoint + c->joints, qd, size);
    memcpy(c->setpoint + 2 * c->joints, qdd, size);
    return 3;
}

static int said(const kc_corrector *c, const double *out, const double *info, int status, double *corrected,
                kc_answer *answer)
{
    memcpy(corrected, out, (size_t)c->joints * sizeof *out);
    if (answer != NULL) {
        const kc_answer told = {
            status, (unsigned)info[0], (unsigned)info[1], (int)info[7],
            {info[LEFT], info[LEFT + 1], info[LEFT + 2]}, info[LEFT_TURN], info[2],
            {-info[REMOVED], -info[REMOVED + 1], -info[REMOVED + 2]}
        };
        *answer = told;
    }
    return status;
}

static int not_loaded(kc_answer *answer, int status)
{
    if (answer != NULL) {
        memset(answer, 0, sizeof *answer);
        answer->status = status;
    }
    return status;
}

int kc_correct(kc_corrector *corrector, const double *q, const double *qd, const double *qdd, double dt,
                   double *corrected, kc_answer *answer)
{
    if (corrector == NULL || corrector->memory == NULL || corrected == NULL) {
        return not_loaded(answer, KC_NOT_LOADED);
    }
    const int width = side_by_side(corrector, q, qd, qdd);
    if (width == 0 || !(dt >= 0.0)) {
        for (int i = 0; i < corrector->joints; i++) {
            corrected[i] = NAN;
        }
        return not_loaded(answer, KC_NOT_FINITE);
    }
    const matrix state = state_of(corrector);
    double *out = state[corrector->joints + 1], *info = state[corrector->joints + 2];
    const int status = correct_setpoint(
        program_of(corrector), scratch_of(corrector), state, corrector->setpoint, width, dt, out, info);
    return said(corrector, out, info, status, corrected, answer);
}

int kc_correct_alone(kc_corrector *corrector, const double *q, const double *qd, const double *qdd,
                         const double *direction, double *corrected, kc_answer *answer)
{
    static const double still[KC_MOST_JOINTS];
    if (corrector == NULL || corrector->memory == NULL || corrected == NULL) {
        return not_loaded(answer, KC_NOT_LOADED);
    }
    const int n = corrector->joints, width = side_by_side(corrector, q, qd, qdd);
    for (int i = 0; i < n * width; i++) {
        if (!(fabs(corrector->setpoint[i]) < INFINITY)) {
            return not_loaded(answer, KC_NOT_FINITE);
        }
    }
    if (width == 0) {
        return not_loaded(answer, KC_NOT_FINITE);
    }
    const matrix state = state_of(corrector);
    double *out = state[n + 1], *info = state[n + 2];
    const int status = correct_row(
        program_of(corrector), scratch_of(corrector), state, corrector->setpoint, width,
        direction == NULL ? still : direction, out, info, n, corrector->moves);
    return said(corrector, out, info, status, corrected, answer);
}

const char *kc_sentence(int code)
{
    switch (code) {
    case KC_OK: return "Corrected.";
    case KC_NOT_FINITE: return "A setpoint is not a number: send finite joints, speeds with accelerations or neither.";
    case KC_JOINT_LIMIT: return "Joints are outside the limits of the arm: see limit_mask, and plan within them.";
    case KC_TOO_LARGE: return "The correction exceeds its limits: raise them on the robot, or check the version.";
    case KC_RATE_LIMIT: return "A joint is asked to move faster than it may: send setpoints closer together.";
    case KC_NOT_LOADED: return "No program is loaded: call kc_load first.";
    case KC_TRUNCATED: return "The program is cut off: export it again.";
    case KC_NOT_A_PROGRAM: return "This is not a program: take what kilter version export --format corrector writes.";
    case KC_NEWER_FORMAT: return "The program is newer than this code: take the kilter_corrector.c of its release.";
    case KC_OTHER_LAYOUT: return "The program is of another release: export it again, or take its kilter_corrector.c.";
    case KC_DAMAGED: return "The program was altered on its way, its checksum is wrong: export it again.";
    case KC_IMPOSSIBLE: return "The program's numbers are those of no arm: export it again.";
    case KC_NO_MEMORY: return "The memory is too small or in use: ask kc_memory_needed, and take another piece.";
    case KC_OTHER_ARM: return "The program is of another robot than the one in use: load it afresh.";
    default: return "Unknown.";
    }
}
