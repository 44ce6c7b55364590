/* The corrector in C inside MATLAB, Simulink or Octave: a MEX function around kilter_corrector.c.
 *
 * SPDX-License-Identifier: Apache-2.0
 *
 *   kilter_corrector_mex('load', bytes, settled)  take a program (uint8), as kilter version export --format corrector writes it
 *   [q, status, flags, left_m] = kilter_corrector_mex('step', wanted, dt)   one setpoint of a stream, rad or m
 *   [q, status, flags, left_m] = kilter_corrector_mex('alone', wanted)      one that follows no other
 *   kilter_corrector_mex('restart', settled)      forget the past
 *
 * One corrector for each MEX function that is loaded. kilter_corrector.m calls it.
 */
#include "kilter_corrector.h"

#include "mex.h"

#include <string.h>

static kc_corrector corrector;
static double *memory = NULL;

static void forget(void)
{
    mxFree(memory);
    memory = NULL;
    memset(&corrector, 0, sizeof corrector);
}

static void load(int nrhs, const mxArray *prhs[])
{
    if (nrhs < 3 || !mxIsUint8(prhs[1])) {
        mexErrMsgIdAndTxt("kilter:usage", "Give the bytes of a program as uint8, and whether the arm rests (settled).");
    }
    const void *bytes = mxGetData(prhs[1]);
    const size_t count = mxGetNumberOfElements(prhs[1]);
    const size_t needed = kc_memory_needed(bytes, count);
    double *fresh = mxMalloc(sizeof(double) * (needed > 0 ? needed : 1));
    kc_corrector loaded;
    memset(&loaded, 0, sizeof loaded);
    const int reason = kc_load(&loaded, bytes, count, fresh, needed, mxGetScalar(prhs[2]) != 0.0);
    if (reason != 0) {
        mxFree(fresh);
        mexErrMsgIdAndTxt("kilter:program", "%s", kc_sentence(reason));
    }
    mexMakeMemoryPersistent(fresh);
    mxFree(memory);
    memory = fresh;
    corrector = loaded;
}

static void correct(int nlhs, mxArray *plhs[], int nrhs, const mxArray *prhs[], int alone)
{
    kc_answer answer;
    if (memory == NULL) {
        mexErrMsgIdAndTxt("kilter:program", "%s", kc_sentence(KC_NOT_LOADED));
    }
    if (nrhs < (alone ? 2 : 3) || !mxIsDouble(prhs[1]) || (int)mxGetNumberOfElements(prhs[1]) != corrector.joints) {
        mexErrMsgIdAndTxt("kilter:usage", "Give %d joints, rad or m%s.", corrector.joints, alone ? "" : ", and the time step, s");
    }
    plhs[0] = mxCreateDoubleMatrix(mxGetM(prhs[1]), mxGetN(prhs[1]), mxREAL);
    double *q = mxGetPr(plhs[0]);
    const double *wanted = mxGetPr(prhs[1]);
    const int status = alone ? kc_correct_alone(&corrector, wanted, NULL, NULL, NULL, q, &answer)
                             : kc_correct(&corrector, wanted, NULL, NULL, mxGetScalar(prhs[2]), q, &answer);
    for (int i = 0; status != KC_OK && i < corrector.joints; i++) {
        q[i] = mxGetNaN();  /* nothing may move by joints without KC_OK */
    }
    const double told[] = {status, answer.flags, answer.left};
    for (int k = 1; k < nlhs && k <= 3; k++) {
        plhs[k] = mxCreateDoubleScalar(told[k - 1]);
    }
}

void mexFunction(int nlhs, mxArray *plhs[], int nrhs, const mxArray *prhs[])
{
    char verb[16] = "";
    mexAtExit(forget);
    if (nrhs < 1 || mxGetString(prhs[0], verb, sizeof verb) != 0) {
        mexErrMsgIdAndTxt("kilter:usage", "Say load, step, alone or restart first.");
    }
    if (strcmp(verb, "load") == 0) {
        load(nrhs, prhs);
    } else if (strcmp(verb, "step") == 0 || strcmp(verb, "alone") == 0) {
        correct(nlhs, plhs, nrhs, prhs, verb[0] == 'a');
    } else if (strcmp(verb, "restart") == 0 && nrhs > 1) {
        kc_restart(&corrector, mxGetScalar(prhs[1]) != 0.0);
    } else {
        mexErrMsgIdAndTxt("kilter:usage", "Say load, step, alone or restart first, restart with settled.");
    }
}
