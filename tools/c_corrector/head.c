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
