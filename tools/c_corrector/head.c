/* Kilter corrector: joint setpoints corrected by the calibration of one arm, in C99.
 *
 * SPDX-License-Identifier: Apache-2.0 OR MIT OR GPL-2.0-or-later
 * Taken under whichever of the three suits: it may go into GPL programs (LinuxCNC) and into closed controllers alike.
 *
 * Translated from the kernels of kilter_core by `make c-corrector`; change those, not this file. It allocates nothing,
 * needs the headers of C99 and the library of math.h, and every loop is bounded by the arm's joints or by the rounds
 * that the program states. Angles rad, lengths m, masses kg, times s.
 */
#include "kilter_corrector.h"

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
