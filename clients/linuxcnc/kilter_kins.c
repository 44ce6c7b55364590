/* Kinematics of a calibrated arm for LinuxCNC: the nominal inverse, then the correction of a version of Kilter.
 *
 * SPDX-License-Identifier: GPL-2.0-or-later
 *
 * The program of the version (`kilter version export VERSION --format corrector`) holds the nominal arm too, so nothing else
 * describes it. X, Y, Z, A, B, C are the robot's own tool in the frame of its root, mm, with A, B, C about x, y and z
 * (first x, then y, then z), deg; joints are in deg, those of prismatic joints in mm. Six joints. Build: see README.md.
 */
#include "kilter_corrector.c"

#include <stdio.h>

#include "rtapi.h"
#include "rtapi_app.h"
#include "hal.h"
#include "emcpos.h"
#include "kinematics.h"

MODULE_LICENSE("GPL");

static char *program = "";
RTAPI_MP_STRING(program, "file of a version, as kilter version export --format corrector writes it");

enum { JOINTS = 6, POSE_ROUNDS = 40, BACK_ROUNDS = 12, MOST_BYTES = 1 << 20 };
#define NEAR 1e-11
#define LONGEST_STEP 0.3
#define DEG (180.0 / 3.14159265358979323846)
#define MM 1e3

typedef struct {
    hal_s32_t *status;      /* of the last correction; 0 is OK */
    hal_u32_t *flags;       /* how it was made */
    hal_float_t *left;      /* of the tool's error, mm */
} pins_t;

static unsigned char content[MOST_BYTES];
static double memory[(KC_MOST_ROWS + KC_MOST_MOVES + 4 * KC_MOST_JOINTS + 64) * KC_COLUMNS];
static kc_corrector corrector;
static double unit[JOINTS];  /* what one of LinuxCNC's units of a joint is, rad or m */
static pins_t *pins;
static int id = -1;

/* The nominal tool at joints, and when asked to, what each joint does to it: (v, w) about the tool point. */
static tuple12 nominal_tool(const double *q, double columns[JOINTS][6])
{
    const rows P = program_of(&corrector);
    const int m = corrector.moves;
    static double lines[KC_MOST_MOVES][6];  /* the stack of a thread of LinuxCNC is small */
    tuple12 T = constant(P, 0, NOMINAL);
    for (int k = 0; k < m; k++) {
        const double moved = P.at[k][RATIO] * q[(int)P.at[k][JOINT]];
        T = k > 0 ? product(T, constant(P, k, NOMINAL)) : T;
        T = P.at[k][KIND] == 0.0 ? rotated_z(T, sin(moved), cos(moved)) : shifted_z(T, moved);
        for (int i = 0; i < 3; i++) {
            lines[k][i] = T.at[2 + 3 * i];
            lines[k][3 + i] = T.at[9 + i];
        }
    }
    T = product(T, constant(P, m, NOMINAL));
    if (columns != NULL) {
        memset(columns, 0, JOINTS * sizeof columns[0]);
        for (int k = 0; k < m; k++) {
            const double *z = lines[k], *p = lines[k] + 3;
            const tuple3 arm = cross(z[0], z[1], z[2], T.at[9] - p[0], T.at[10] - p[1], T.at[11] - p[2]);
            const bool rotates = P.at[k][KIND] == 0.0;
            double *column = columns[(int)P.at[k][JOINT]];
            for (int i = 0; i < 3; i++) {
                column[i] += P.at[k][RATIO] * (rotates ? arm.at[i] : z[i]);
                column[3 + i] += P.at[k][RATIO] * (rotates ? z[i] : 0.0);
            }
        }
    }
    return T;
}

/* Solve for the step of the joints by elimination with pivots; false where the columns are dependent. */
static bool step_of(double columns[JOINTS][6], const double *error, double *step)
{
    double A[6][7];
    for (int i = 0; i < 6; i++) {
        for (int j = 0; j < JOINTS; j++) {
            A[i][j] = columns[j][i];
        }
        A[i][6] = error[i];
    }
    for (int j = 0; j < 6; j++) {
        int best = j;
        for (int i = j + 1; i < 6; i++) {
            best = fabs(A[i][j]) > fabs(A[best][j]) ? i : best;
        }
        if (fabs(A[best][j]) < 1e-9) {
            return false;
        }
        for (int k = 0; k < 7; k++) {
            const double kept = A[j][k];
            A[j][k] = A[best][k];
            A[best][k] = kept;
        }
        for (int i = 0; i < 6; i++) {
            const double share = i == j ? 0.0 : A[i][j] / A[j][j];
            for (int k = j; k < 7; k++) {
                A[i][k] -= share * A[j][k];
            }
        }
    }
    for (int j = 0; j < 6; j++) {
        step[j] = A[j][6] / A[j][j];
    }
    return true;
}

/* Nominal joints that bring the tool to a pose, from those that are given; false when none are found. */
static bool nominal_joints(tuple12 wanted, double *q)
{
    double columns[JOINTS][6], step[JOINTS];
    for (int round = 0; round < POSE_ROUNDS; round++) {
        const tuple12 T = nominal_tool(q, columns);
        const tuple3 rotation = rotation_between(T, wanted);
        double error[6], largest = 0.0, longest = 0.0;
        for (int i = 0; i < 3; i++) {
            error[i] = wanted.at[9 + i] - T.at[9 + i];
            error[3 + i] = T.at[3 * i] * rotation.at[0] + T.at[3 * i + 1] * rotation.at[1] + T.at[3 * i + 2] * rotation.at[2];
        }
        for (int i = 0; i < 6; i++) {
            largest = fmax(largest, fabs(error[i]));
        }
        if (largest < NEAR) {
            return true;
        }
        if (!step_of(columns, error, step)) {
            return false;
        }
        for (int i = 0; i < JOINTS; i++) {
            longest = fmax(longest, fabs(step[i]));
        }
        for (int i = 0; i < JOINTS; i++) {
            q[i] += step[i] * (longest > LONGEST_STEP ? LONGEST_STEP / longest : 1.0);
        }
    }
    return false;
}

static tuple12 pose_of(const EmcPose *pose)
{
    const double sa = sin(pose->a / DEG), ca = cos(pose->a / DEG), sb = sin(pose->b / DEG), cb = cos(pose->b / DEG);
    const double sc = sin(pose->c / DEG), cc = cos(pose->c / DEG);
    return (tuple12){{cc * cb, cc * sb * sa - sc * ca, cc * sb * ca + sc * sa, sc * cb, sc * sb * sa + cc * ca,
        sc * sb * ca - cc * sa, -sb, cb * sa, cb * ca, pose->tran.x / MM, pose->tran.y / MM, pose->tran.z / MM}};
}

int kinematicsInverse(const EmcPose *pose, double *joint, const KINEMATICS_INVERSE_FLAGS *iflags,
                      KINEMATICS_FORWARD_FLAGS *fflags)
{
    double q[JOINTS], corrected[KC_MOST_JOINTS];
    kc_answer answer;
    (void)iflags;
    (void)fflags;
    for (int i = 0; i < JOINTS; i++) {
        q[i] = joint[i] * unit[i];  /* where the arm is: the nominal joints are beside it */
    }
    if (!nominal_joints(pose_of(pose), q)) {
        return -1;
    }
    *pins->status = kc_correct_alone(&corrector, q, NULL, NULL, NULL, corrected, &answer);
    *pins->flags = answer.flags;
    *pins->left = answer.left * MM;
    if (*pins->status != KC_OK) {
        return -1;
    }
    for (int i = 0; i < JOINTS; i++) {
        joint[i] = corrected[i] / unit[i];
    }
    return 0;
}

int kinematicsForward(const double *joint, EmcPose *pose, const KINEMATICS_FORWARD_FLAGS *fflags,
                      KINEMATICS_INVERSE_FLAGS *iflags)
{
    double q[JOINTS], corrected[KC_MOST_JOINTS];
    kc_answer answer;
    (void)iflags;
    (void)fflags;
    for (int i = 0; i < JOINTS; i++) {
        q[i] = joint[i] * unit[i];
    }
    for (int round = 0; round < BACK_ROUNDS; round++) {  /* the wanted joints whose correction these are */
        double farthest = 0.0;
        if (kc_correct_alone(&corrector, q, NULL, NULL, NULL, corrected, &answer) != KC_OK) {
            return -1;
        }
        for (int i = 0; i < JOINTS; i++) {
            const double off = joint[i] * unit[i] - corrected[i];
            q[i] += off;
            farthest = fmax(farthest, fabs(off));
        }
        if (farthest < NEAR) {
            break;
        }
    }
    const tuple12 T = nominal_tool(q, NULL);
    pose->tran.x = T.at[9] * MM;
    pose->tran.y = T.at[10] * MM;
    pose->tran.z = T.at[11] * MM;
    pose->a = atan2(T.at[7], T.at[8]) * DEG;
    pose->b = atan2(-T.at[6], hypot(T.at[0], T.at[3])) * DEG;
    pose->c = atan2(T.at[3], T.at[0]) * DEG;
    return 0;
}

KINEMATICS_TYPE kinematicsType(void) { return KINEMATICS_BOTH; }

static int loaded(void)
{
    FILE *file = fopen(program, "rb");
    const size_t bytes = file == NULL ? 0 : fread(content, 1, sizeof content, file);
    if (file != NULL) {
        fclose(file);
    }
    const int reason = kc_load(&corrector, content, bytes, memory, sizeof memory / sizeof memory[0], 1);
    if (reason != 0 || corrector.joints != JOINTS) {
        rtapi_print_msg(RTAPI_MSG_ERR, "kilter_kins: program=%s: %s\n", program,
                        file == NULL ? "cannot be read" : reason != 0 ? kc_sentence(reason) : "its arm has not six joints");
        return -1;
    }
    const rows P = program_of(&corrector);
    for (int k = 0; k < corrector.moves; k++) {
        unit[(int)P.at[k][JOINT]] = P.at[k][KIND] == 0.0 ? 1.0 / DEG : 1.0 / MM;
    }
    return 0;
}

int rtapi_app_main(void)
{
    if (loaded() != 0) {
        return -1;
    }
    id = hal_init("kilter_kins");
    if (id < 0) {
        return id;
    }
    pins = hal_malloc(sizeof *pins);
    if (pins == NULL || hal_pin_s32_newf(HAL_OUT, &pins->status, id, "kilter-kins.status") != 0 ||
        hal_pin_u32_newf(HAL_OUT, &pins->flags, id, "kilter-kins.flags") != 0 ||
        hal_pin_float_newf(HAL_OUT, &pins->left, id, "kilter-kins.left-mm") != 0) {
        hal_exit(id);
        return -1;
    }
    hal_ready(id);
    return 0;
}

void rtapi_app_exit(void) { hal_exit(id); }

KINS_NOT_SWITCHABLE
EXPORT_SYMBOL(kinematicsType);
EXPORT_SYMBOL(kinematicsInverse);
EXPORT_SYMBOL(kinematicsForward);
