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
