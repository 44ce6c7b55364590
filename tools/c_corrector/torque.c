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

@KERNELS@
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
