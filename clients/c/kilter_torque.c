/* Kilter torques: what one setpoint of an arm needs of its drives, in C99. `kilter version export VERSION --format torque-c`
 * writes a file that begins with the table kt_table of one version; this code follows it.
 *
 * SPDX-License-Identifier: Apache-2.0 OR MIT OR GPL-2.0-or-later
 *
 * Translated from kilter_core/motion/kernels/torque.py by `python -m tools.c_corrector`; change that, not this file. It
 * allocates nothing and keeps nothing: call it from as many threads as you like. Angles rad, lengths m, times s.
 *
 *     void kt_torques(const double *q, const double *qd, const double *qdd, double *tau);
 *
 * writes N m (N of a prismatic joint), NAN at joints of which the log said nothing.
 */
#if defined(__clang__)
#pragma STDC FP_CONTRACT OFF
#elif defined(__GNUC__)
#pragma GCC optimize("fp-contract=off")
#elif defined(_MSC_VER)
#pragma fp_contract(off)
#endif

#include <math.h>
#include <stdbool.h>

typedef double (*matrix)[KT_COLUMNS];
typedef struct { const double (*at)[KT_COLUMNS]; } rows;

/* ---- motion/torque --------------------------------------------------------------------------------------- */

enum {
    TORQUE_COLUMNS = 22, ROTATES = 0, ALONG = 1, SECOND = 2, THIRD = 3, SINE = 4, COSINE = 5, JOINT = 6, RATIO = 7,
    ZERO = 8, CARRIES = 9, BODY = 10, OFFSET = 0, COULOMB = 1, VISCOUS = 2, STRIBECK = 3, ROOT = 4, QUADRATIC = 5,
    ONE_SIDED = 6, LOADED = 7, ROTOR = 8, GAIN = 9, RIPPLE = 10, SPRING = 12, BALANCE = 13, CABLE = 15, KNOWN = 17,
    WIDTH = 18, LOOSE = 19, MIDDLE = 20, ORDER = 21, SPIN = 0, SPUN = 3, FALL = 6, MOVED = 9, FORCE = 11, MOMENT = 14
};

/* Motion of the frame behind element k from that before it, both in their own axes. */
static void move_outward(rows P, matrix W, int k, int n, const double *x)
{
    int i = (int)P.at[k][ALONG];
    int a = (int)P.at[k][SECOND];
    int b = (int)P.at[k][THIRD];
    int j = (int)P.at[k][JOINT];
    double amount = 0.0;
    double speed = 0.0;
    double rate = 0.0;
    if (j >= 0) {
        double ratio = P.at[k][RATIO];
        amount = ratio * x[j] + P.at[k][ZERO];
        speed = ratio * x[n + j];
        rate = ratio * x[2 * n + j];
    }
    if (P.at[k][ROTATES] != 0.0) {
        W[k][SPUN + a] += speed * W[k][SPIN + b];
        W[k][SPUN + b] -= speed * W[k][SPIN + a];
        W[k][SPIN + i] += speed;
        W[k][SPUN + i] += rate;
        W[k][MOVED] = j >= 0 ? sin(amount) : P.at[k][SINE];
        W[k][MOVED + 1] = j >= 0 ? cos(amount) : P.at[k][COSINE];
        double s = W[k][MOVED];
        double c = W[k][MOVED + 1];
        for (int at = SPIN; at < MOVED; at += 3) {
            W[k + 1][at + i] = W[k][at + i];
            W[k + 1][at + a] = c * W[k][at + a] + s * W[k][at + b];
            W[k + 1][at + b] = c * W[k][at + b] - s * W[k][at + a];
        }
        return;
    }
    double d = j >= 0 ? amount : P.at[k][SINE];
    W[k][MOVED] = d;
    for (int column = SPIN; column < MOVED; column++) {
        W[k + 1][column] = W[k][column];
    }
    double w0 = W[k][SPIN + i];
    double w1 = W[k][SPIN + a];
    double w2 = W[k][SPIN + b];
    W[k + 1][FALL + i] += rate - d * (w1 * w1 + w2 * w2);
    W[k + 1][FALL + a] += d * (W[k][SPUN + b] + w0 * w1) + 2.0 * speed * w2;
    W[k + 1][FALL + b] += d * (w0 * w2 - W[k][SPUN + a]) - 2.0 * speed * w1;
}

/* Force and moment about the origin that move the body behind element k. */
static void load_body(rows P, matrix W, int k)
{
    double mass = P.at[k][BODY];
    double s0 = P.at[k][BODY + 1];
    double s1 = P.at[k][BODY + 2];
    double s2 = P.at[k][BODY + 3];
    double xx = P.at[k][BODY + 4];
    double xy = P.at[k][BODY + 5];
    double xz = P.at[k][BODY + 6];
    double yy = P.at[k][BODY + 7];
    double yz = P.at[k][BODY + 8];
    double zz = P.at[k][BODY + 9];
    double w0 = W[k + 1][SPIN];
    double w1 = W[k + 1][SPIN + 1];
    double w2 = W[k + 1][SPIN + 2];
    double d0 = W[k + 1][SPUN];
    double d1 = W[k + 1][SPUN + 1];
    double d2 = W[k + 1][SPUN + 2];
    double a0 = W[k + 1][FALL];
    double a1 = W[k + 1][FALL + 1];
    double a2 = W[k + 1][FALL + 2];
    double u0 = w1 * s2 - w2 * s1;
    double u1 = w2 * s0 - w0 * s2;
    double u2 = w0 * s1 - w1 * s0;
    W[k][FORCE] = mass * a0 + d1 * s2 - d2 * s1 + w1 * u2 - w2 * u1;
    W[k][FORCE + 1] = mass * a1 + d2 * s0 - d0 * s2 + w2 * u0 - w0 * u2;
    W[k][FORCE + 2] = mass * a2 + d0 * s1 - d1 * s0 + w0 * u1 - w1 * u0;
    double h0 = xx * w0 + xy * w1 + xz * w2;
    double h1 = xy * w0 + yy * w1 + yz * w2;
    double h2 = xz * w0 + yz * w1 + zz * w2;
    W[k][MOMENT] = s1 * a2 - s2 * a1 + xx * d0 + xy * d1 + xz * d2 + w1 * h2 - w2 * h1;
    W[k][MOMENT + 1] = s2 * a0 - s0 * a2 + xy * d0 + yy * d1 + yz * d2 + w2 * h0 - w0 * h2;
    W[k][MOMENT + 2] = s0 * a1 - s1 * a0 + xz * d0 + yz * d1 + zz * d2 + w0 * h1 - w1 * h0;
}

/* Add the loads of the bodies from the last element inward, and what each drive carries of them to out. */
static void add_inward(rows P, matrix W, int m, double *out)
{
    for (int k = m - 1; k > -1; k--) {
        int i = (int)P.at[k][ALONG];
        int a = (int)P.at[k][SECOND];
        int b = (int)P.at[k][THIRD];
        bool rotates = P.at[k][ROTATES] != 0.0;
        if (P.at[k][CARRIES] != 0.0) {
            out[(int)P.at[k][JOINT]] += P.at[k][RATIO] * (rotates ? W[k][MOMENT + i] : W[k][FORCE + i]);
        }
        if (k == 0) {
            return;
        }
        if (rotates) {
            double s = W[k][MOVED];
            double c = W[k][MOVED + 1];
            for (int at = FORCE; at < MOMENT + 1; at += 3) {
                W[k - 1][at + i] += W[k][at + i];
                W[k - 1][at + a] += c * W[k][at + a] - s * W[k][at + b];
                W[k - 1][at + b] += s * W[k][at + a] + c * W[k][at + b];
            }
        } else {
            double d = W[k][MOVED];
            for (int column = FORCE; column < MOMENT + 3; column++) {
                W[k - 1][column] += W[k][column];
            }
            W[k - 1][MOMENT + a] -= d * W[k][FORCE + b];
            W[k - 1][MOMENT + b] += d * W[k][FORCE + a];
        }
    }
}

/* Torque of a joint: the load of its bodies with friction and all else that was found of it. */
static double joint_torque(rows P, int row, double q, double qd, double qdd, double load)
{
    double sign = tanh(qd / P.at[row][WIDTH]);
    double fast = fabs(qd);
    double away = q - P.at[row][MIDDLE];
    double slow = qd / P.at[row][LOOSE];
    double model = load + P.at[row][OFFSET] + P.at[row][COULOMB] * sign + P.at[row][VISCOUS] * qd;
    double out = model + P.at[row][GAIN] * model + P.at[row][ROTOR] * qdd;
    out += sign * (P.at[row][STRIBECK] * exp(-slow * slow) + P.at[row][ROOT] * sqrt(fast));
    out += P.at[row][QUADRATIC] * qd * fast + P.at[row][ONE_SIDED] * fast + P.at[row][LOADED] * fabs(load) * sign;
    double phase = P.at[row][ORDER] * q;
    out += P.at[row][RIPPLE] * sin(phase) + P.at[row][RIPPLE + 1] * cos(phase);
    out += P.at[row][SPRING] * away + P.at[row][BALANCE] * sin(q) + P.at[row][BALANCE + 1] * cos(q);
    return out + (P.at[row][CABLE] + P.at[row][CABLE + 1] * away) * away * away;
}

/* Torques out (n) of the setpoint x: joints, speeds, accelerations; NaN at joints of which nothing is known. m
 * elements; W has a row more than these. */
static void feed_forward(rows P, matrix W, int m, int n, const double *x, double *out)
{
    int i = 0;
    for (int i_at = 0; i_at < 3; i_at++) {
        i = i_at;
        W[0][SPIN + i] = 0.0;
        W[0][SPUN + i] = 0.0;
        W[0][FALL + i] = -P.at[m + n][i];
    }
    for (int k = 0; k < m; k++) {
        move_outward(P, W, k, n, x);
        load_body(P, W, k);
    }
    for (int i_at = 0; i_at < n; i_at++) {
        i = i_at;
        out[i] = 0.0;
    }
    add_inward(P, W, m, out);
    for (int i_at = 0; i_at < n; i_at++) {
        i = i_at;
        double load = out[i];
        out[i] = P.at[m + i][KNOWN] != 0.0 ? joint_torque(P, m + i, x[i], x[n + i], x[2 * n + i], load) : NAN;
    }
}

void kt_torques(const double *q, const double *qd, const double *qdd, double *tau);

void kt_torques(const double *q, const double *qd, const double *qdd, double *tau)
{
    const rows table = {kt_table};
    double setpoint[3 * KT_JOINTS], scratch[KT_ELEMENTS + 1][KT_COLUMNS] = {{0.0}};
    for (int i = 0; i < KT_JOINTS; i++) {
        setpoint[i] = q[i];
        setpoint[KT_JOINTS + i] = qd[i];
        setpoint[2 * KT_JOINTS + i] = qdd[i];
    }
    feed_forward(table, scratch, KT_ELEMENTS, KT_JOINTS, setpoint, tau);
}
