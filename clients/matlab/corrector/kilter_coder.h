/* What kilter_correct_coder.m calls: one corrector, its program a constant. See kilter_coder.c.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef KILTER_CODER_H
#define KILTER_CODER_H

/* Correct one setpoint, dt s after the last one; the first one loads the program, and the arm rests there. Returns the
 * status; `corrected`, joints many, is NaN unless it is 0. A number of joints that is not the arm's: KC_NOT_LOADED. */
int kilter_coder_step(const double *wanted, int joints, double dt, double *corrected);

#endif
