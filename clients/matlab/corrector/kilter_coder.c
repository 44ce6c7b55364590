/* One corrector for code that MATLAB Coder generates. Define KILTER_PROGRAM as what `kilter version export --format c` wrote:
 *   cc -DKILTER_PROGRAM='"arm.c"' -c kilter_coder.c
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef KILTER_PROGRAM
#define KILTER_PROGRAM "arm.c"
#endif
#include KILTER_PROGRAM

#include "kilter_coder.h"

static kc_corrector kilter_coder;
/* the program, and what the corrector works in beside it */
static double kilter_coder_memory[sizeof kc_program / sizeof(double) + (KC_MOST_MOVES + 4 * KC_MOST_JOINTS + 16) * KC_COLUMNS];

int kilter_coder_step(const double *wanted, int joints, double dt, double *corrected)
{
    if (kilter_coder.memory == NULL) {
        const size_t doubles = sizeof kilter_coder_memory / sizeof kilter_coder_memory[0];
        kc_load(&kilter_coder, kc_program, sizeof kc_program, kilter_coder_memory, doubles, 1);
    }
    if (kilter_coder.memory == NULL || joints != kilter_coder.joints) {
        for (int i = 0; i < joints; i++) {
            corrected[i] = NAN;
        }
        return KC_NOT_LOADED;
    }
    return kc_correct(&kilter_coder, wanted, NULL, NULL, dt, corrected, NULL);
}
