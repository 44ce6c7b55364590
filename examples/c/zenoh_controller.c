/* A whole controller over zenoh-pico (1.9): a path at a fixed cycle, each setpoint corrected in time or else held, faded and
 * sent all the same.
 *
 *     zenoh_controller ENDPOINT SITE ROBOT STREAM SESSION_ID KEY JOINTS CYCLES CYCLE_US
 *
 * SESSION_ID and KEY are hexadecimal, as POST /v1/robots/{robot}/stream/sessions (or kilter server stream-session) gives them;
 * ENDPOINT is tcp/127.0.0.1:7447 for instance. Every cycle prints what would go to the drives and how it came about.
 *
 * Two things run beside the loop: zenoh-pico's own thread puts answers into a queue, and one of ours asks which version
 * counts whenever the corrector announces a change. Before you measure anything give the loop real-time priority
 * (chrt --fifo 50 ...) and lock its memory: under load that takes late cycles at 1 kHz from 1.3 % to 0.02 %.
 *
 * Build: cc -std=c11 -O2 -I. -I$PICO/include zenoh_controller.c $PICO_BUILD/lib/libzenohpico.a -lpthread -lm */
#define _POSIX_C_SOURCE 200809L
#define ZENOH_LINUX
#include <math.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include <zenoh-pico.h>

#include "kilter_frames.h"

#define MOST_BYTES 4096
#define ANSWERS 16            /* that may wait; older ones are dropped */
#define HOLD_CYCLES 20        /* the last good difference is held for so many cycles, */
#define FADE_CYCLES 200       /* then released over so many */
#define SILENT_CYCLES 20      /* without any answer, before the session is greeted anew */
#define LARGEST_RAD 0.0349    /* the controller's own ceiling: no correction is larger than 2 degrees (or 35 mm) */
#define RATE_RAD_S 0.0873     /* and none changes faster than 5 degrees (or 87 mm) a second, as it comes in too */
#define PI 3.14159265358979323846

static kilter_session session;

/* ---- time, randomness ------------------------------------------------------------------------------------------- */

static uint64_t now_ns(void) {
    struct timespec at;
    clock_gettime(CLOCK_MONOTONIC, &at);
    return (uint64_t)at.tv_sec * 1000000000u + (uint64_t)at.tv_nsec;
}

static uint64_t random_bits(int bits) {
    uint64_t value;
    z_random_fill(&value, sizeof value);
    return value >> (64 - bits);
}

/* ---- answers: a ring that zenoh-pico's thread fills -------------------------------------------------------------- */

typedef struct {
    uint8_t data[MOST_BYTES];
    size_t length;
} frame_bytes;

static struct {
    pthread_mutex_t lock;
    pthread_cond_t came;
    frame_bytes held[ANSWERS];
    unsigned first, last;     /* last - first of them wait */
} answers;

static size_t copy_bytes(const z_loaned_bytes_t *payload, uint8_t *to, size_t most) {
    z_bytes_reader_t reader = z_bytes_get_reader(payload);
    return z_bytes_len(payload) > most ? 0 : z_bytes_reader_read(&reader, to, most);
}

static void on_answer(z_loaned_sample_t *sample, void *context) {
    (void)context;
    pthread_mutex_lock(&answers.lock);
    frame_bytes *free_one = &answers.held[answers.last % ANSWERS];
    free_one->length = copy_bytes(z_sample_payload(sample), free_one->data, MOST_BYTES);
    if (free_one->length > 0) {
        answers.last++;
        if (answers.last - answers.first > ANSWERS) answers.first++;
        pthread_cond_signal(&answers.came);
    }
    pthread_mutex_unlock(&answers.lock);
}

/* Take the oldest answer, waiting for one until the deadline; 0 when none came. */
static int take_answer(frame_bytes *into, uint64_t deadline_ns) {
    const struct timespec until = {(time_t)(deadline_ns / 1000000000u), (long)(deadline_ns % 1000000000u)};
    int found = 0, waited = 0;
    pthread_mutex_lock(&answers.lock);
    while (answers.first == answers.last && waited == 0)
        waited = pthread_cond_timedwait(&answers.came, &answers.lock, &until);
    if (answers.first != answers.last) {
        *into = answers.held[answers.first++ % ANSWERS];
        found = 1;
    }
    pthread_mutex_unlock(&answers.lock);
    return found;
}

/* What waits from before must not be taken for the answer to what is sent next. */
static void drop_waiting(void) {
    pthread_mutex_lock(&answers.lock);
    answers.first = answers.last;
    pthread_mutex_unlock(&answers.lock);
}

/* ---- which version counts ---------------------------------------------------------------------------------------- */

static struct {
    pthread_mutex_t lock;
    pthread_cond_t asked;
    int ask, stop;
    uint64_t version;
    uint32_t epoch;           /* 0: none */
    uint8_t question[32];     /* session id, 16 random bytes */
} announced = {.ask = 1};

/* An announcement is never believed, anybody can publish one: it makes us ask, and the reply is signed for our question. */
static void on_announcement(z_loaned_sample_t *sample, void *context) {
    (void)sample, (void)context;
    pthread_mutex_lock(&announced.lock);
    announced.ask = 1;
    pthread_cond_signal(&announced.asked);
    pthread_mutex_unlock(&announced.lock);
}

/* Whether a document ends in the tag of this question: over its 16 random bytes, the key, a zero byte, and the document
 * as it was without its signature, which then ends it. */
static int reply_is_signed(char *document, const char *key) {
    static const char mark[] = ", \"signature\": \"";
    static uint8_t message[MOST_BYTES + 512];
    char *at = NULL;
    for (char *next = strstr(document, mark); next; next = strstr(next + 1, mark)) at = next;
    if (!at || strlen(at) != sizeof mark - 1 + 2 * KILTER_TAG_BYTES + 2) return 0;
    uint8_t tag[KILTER_TAG_BYTES], differ = 0;
    char said[2 * KILTER_TAG_BYTES + 1];
    memcpy(said, at + sizeof mark - 1, 2 * KILTER_TAG_BYTES);
    at[0] = '}';
    at[1] = '\0';
    const size_t key_bytes = strlen(key) + 1, body = strlen(document);
    if (16 + key_bytes + body > sizeof message) return 0;
    memcpy(message, announced.question + 16, 16);
    memcpy(message + 16, key, key_bytes);
    memcpy(message + 16 + key_bytes, document, body);
    kilter_tag(tag, session.key, "KLT2rply", message, 16 + key_bytes + body);
    for (int i = 0; i < KILTER_TAG_BYTES; i++) {
        char hex[3];
        snprintf(hex, sizeof hex, "%02x", tag[i]);
        differ |= (uint8_t)(hex[0] ^ said[2 * i]) | (uint8_t)(hex[1] ^ said[2 * i + 1]);
    }
    return differ == 0;
}

/* The text behind "name": of a flat JSON document, NULL when it has none. */
static const char *field(const char *document, const char *name) {
    char quoted[64];
    snprintf(quoted, sizeof quoted, "\"%s\":", name);
    const char *at = strstr(document, quoted);
    if (!at) return NULL;
    at += strlen(quoted);
    while (*at == ' ') at++;
    return at;
}

static void on_reply(z_loaned_reply_t *reply, void *key) {
    static char document[MOST_BYTES];
    if (!z_reply_is_ok(reply)) return;
    const size_t length = copy_bytes(z_sample_payload(z_reply_ok(reply)), (uint8_t *)document, MOST_BYTES - 1);
    document[length] = '\0';
    if (!reply_is_signed(document, key)) return;
    const char *version = field(document, "version"), *epoch = field(document, "epoch");
    if (!version || !epoch) return;
    pthread_mutex_lock(&announced.lock);
    if (*version == '"') {
        announced.version = strtoull(version + 1, NULL, 16);
        announced.epoch = (uint32_t)strtoul(epoch, NULL, 10);
    } else {
        announced.epoch = 0;  /* null: no version is active */
    }
    pthread_mutex_unlock(&announced.lock);
}

typedef struct {
    const z_loaned_session_t *zenoh;
    char key[512], parameters[300];
} asking;

/* Ask whenever something was announced: in a thread of its own, for the loop has no time to wait. */
static void *ask_versions(void *context) {
    asking *how = context;
    for (;;) {
        pthread_mutex_lock(&announced.lock);
        while (!announced.ask && !announced.stop) pthread_cond_wait(&announced.asked, &announced.lock);
        const int stop = announced.stop;
        announced.ask = 0;
        memcpy(announced.question, session.id, 16);
        z_random_fill(announced.question + 16, 16);
        pthread_mutex_unlock(&announced.lock);
        if (stop) return NULL;
        z_view_keyexpr_t key;
        z_view_keyexpr_from_str(&key, how->key);
        z_owned_closure_reply_t take;
        z_closure(&take, on_reply, NULL, how->key);
        z_owned_bytes_t question;
        z_bytes_copy_from_buf(&question, announced.question, sizeof announced.question);
        z_get_options_t options;
        z_get_options_default(&options);
        options.payload = z_move(question);
        options.timeout_ms = 1000;
        z_get(how->zenoh, z_loan(key), how->parameters, z_move(take), &options);
        const struct timespec pause = {0, 100000000}; /* many announcements are one question */
        nanosleep(&pause, NULL);
    }
}

/* ---- the loop ----------------------------------------------------------------------------------------------------- */

static struct {
    uint64_t seq, clock_offset;
    int joints, greeted, silent, reset, gaps;
    double now[KILTER_MAX_JOINTS];  /* difference of what was sent last and wanted */
    double last[KILTER_MAX_JOINTS]; /* the same at the last good answer */
    int since;                      /* cycles since then */
} loop;

static void put(const z_loaned_publisher_t *way, const uint8_t *data, size_t length) {
    z_owned_bytes_t payload;
    z_bytes_copy_from_buf(&payload, data, length);
    z_publisher_put(way, z_move(payload), NULL);
}

/* Greet until the corrector's nonce has come; a cycle at most. */
static void greet(const z_loaned_publisher_t *way, uint64_t deadline_ns) {
    uint8_t frame[KILTER_HEADER_BYTES + KILTER_TRAILER_BYTES];
    const uint64_t seq = random_bits(62), sent = random_bits(62);
    static frame_bytes answer;
    drop_waiting();
    put(way, frame, kilter_greet(frame, &session, seq, sent));
    while (!loop.greeted && take_answer(&answer, deadline_ns))
        loop.greeted = kilter_challenged(answer.data, answer.length, &session, seq, sent);
    if (loop.greeted) loop.reset = 1, loop.silent = 0;
}

/* What a refusal asks of the next setpoint. */
static void heed(int status) {
    loop.gaps = status == KILTER_SEQ_GAP || status == KILTER_OVERLOAD ? loop.gaps + 1 : 0;
    if (status == KILTER_STALE || status == KILTER_SEQ_BACK || status == KILTER_RATE_LIMIT || loop.gaps >= 2) loop.reset = 1;
}

/* Send one setpoint and wait for its answer until the deadline. Returns its status, or -1 when none came in time. */
static int correct(const z_loaned_publisher_t *way, const double *wanted, double *out, uint64_t deadline_ns) {
    static uint8_t frame[KILTER_SETPOINT_BYTES];
    static frame_bytes answer;
    double largest[KILTER_MAX_JOINTS];
    for (int i = 0; i < loop.joints; i++) largest[i] = LARGEST_RAD;
    pthread_mutex_lock(&announced.lock);
    const uint32_t epoch = announced.epoch;
    const uint64_t version = announced.version;
    pthread_mutex_unlock(&announced.lock);
    const uint16_t flags = loop.reset ? KILTER_RESET | KILTER_SETTLED : 0;
    const uint64_t clock = now_ns() + loop.clock_offset, sent = (clock & ~(uint64_t)0xfffff) | random_bits(20);
    loop.seq++;
    size_t length = kilter_encode(frame, wanted, NULL, NULL, loop.joints, flags, loop.seq, sent, clock, 0);
    length = kilter_seal(frame, length, &session);
    drop_waiting();
    put(way, frame, length);
    while (take_answer(&answer, deadline_ns)) {
        kilter_answer said;
        if (kilter_challenged(answer.data, answer.length, &session, loop.seq, sent)) {
            loop.reset = 1; /* the corrector was restarted: the next setpoint is signed with the new key */
            return KILTER_NO_SESSION;
        }
        const size_t opened = kilter_open(answer.data, answer.length, &session);
        if (!opened || !kilter_decode(answer.data, opened, &said)) continue;
        if (!kilter_accept(&said, loop.seq, sent, clock, wanted, largest, loop.joints, epoch, version)) {
            if (said.seq == loop.seq && said.status == KILTER_OK && said.epoch != epoch) on_announcement(NULL, NULL);
            continue;
        }
        loop.reset = 0;
        loop.silent = 0;
        heed(said.status);
        if (said.status == KILTER_OK) memcpy(out, said.q, sizeof said.q);
        return said.status;
    }
    if (++loop.silent >= SILENT_CYCLES) loop.greeted = 0;
    return -1;
}

/* Wanted joints plus what is left of the last difference. */
static void bypass(const double *wanted, double *out) {
    double share = 1.0;
    loop.since++;
    if (loop.since > HOLD_CYCLES) {
        const double part = (double)(loop.since - HOLD_CYCLES) / FADE_CYCLES;
        share = part >= 1.0 ? 0.0 : 1.0 - part * part * (3.0 - 2.0 * part);
    }
    for (int i = 0; i < loop.joints; i++) {
        loop.now[i] = share * loop.last[i];
        out[i] = wanted[i] + loop.now[i];
    }
}

/* A good answer: the difference goes there from where it is by at most so much, by one share of all joints. */
static void follow(const double *wanted, double *out, double most) {
    double farthest = 0.0;
    for (int i = 0; i < loop.joints; i++) farthest = fmax(farthest, fabs(out[i] - wanted[i] - loop.now[i]));
    for (int i = 0; i < loop.joints; i++) {
        if (farthest > most) out[i] = wanted[i] + loop.now[i] + most / farthest * (out[i] - wanted[i] - loop.now[i]);
        loop.now[i] = loop.last[i] = out[i] - wanted[i];
    }
    loop.since = 0;
}

static void run(const z_loaned_publisher_t *way, long cycles, uint64_t cycle_ns) {
    uint64_t next = now_ns();
    for (long cycle = 0; cycle < cycles; cycle++) {
        double wanted[KILTER_MAX_JOINTS], out[KILTER_MAX_JOINTS];
        const double t = (double)cycle * (double)cycle_ns * 1e-9;
        for (int i = 0; i < loop.joints; i++) wanted[i] = 0.3 + 0.2 * sin(2.0 * PI * 0.2 * t + i);
        const uint64_t deadline = next + cycle_ns * 4 / 5;
        int status = -1;
        if (!loop.greeted) greet(way, deadline);
        else status = correct(way, wanted, out, deadline);
        if (status == KILTER_OK) follow(wanted, out, RATE_RAD_S * (double)cycle_ns * 1e-9);
        else bypass(wanted, out);
        printf("%ld %d %d", cycle, status, loop.since);
        for (int i = 0; i < loop.joints; i++) printf(" %.17g %.17g", wanted[i], out[i]);
        printf("\n");
        next += cycle_ns;
        const struct timespec until = {(time_t)(next / 1000000000u), (long)(next % 1000000000u)};
        clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, NULL);
    }
}

/* ---- start and end ------------------------------------------------------------------------------------------------ */

static int read_hex(const char *text, uint8_t *to, size_t count) {
    if (strlen(text) != 2 * count) return 0;
    for (size_t i = 0; i < count; i++) {
        unsigned byte;
        if (sscanf(text + 2 * i, "%2x", &byte) != 1) return 0;
        to[i] = (uint8_t)byte;
    }
    return 1;
}

static int fail(const char *sentence) {
    fprintf(stderr, "%s\n", sentence);
    return 2;
}

int main(int count, char **given) {
    if (count != 10) return fail("usage: zenoh_controller ENDPOINT SITE ROBOT STREAM SESSION_ID KEY JOINTS CYCLES CYCLE_US");
    if (!read_hex(given[5], session.id, 16) || !read_hex(given[6], session.key, 32))
        return fail("SESSION_ID has 32 and KEY 64 hexadecimal digits: see kilter server stream-session.");
    loop.joints = atoi(given[7]);
    if (loop.joints < 1 || loop.joints > KILTER_MAX_JOINTS) return fail("JOINTS is a number from 1 to 16.");
    char base[256], in[320], out[320];
    static asking how;
    snprintf(base, sizeof base, "kilter/@v1/%s/%s", given[2], given[3]);
    snprintf(in, sizeof in, "%s/stream/%s/in", base, given[4]);
    snprintf(out, sizeof out, "%s/stream/%s/out", base, given[4]);
    snprintf(how.key, sizeof how.key, "%s/active", base);
    snprintf(how.parameters, sizeof how.parameters, "stream=%s", given[4]);

    pthread_condattr_t monotonic;
    pthread_condattr_init(&monotonic);
    pthread_condattr_setclock(&monotonic, CLOCK_MONOTONIC);
    pthread_cond_init(&answers.came, &monotonic);
    pthread_cond_init(&announced.asked, NULL);
    pthread_mutex_init(&answers.lock, NULL);
    pthread_mutex_init(&announced.lock, NULL);

    z_owned_config_t config;
    z_config_default(&config);
    zp_config_insert(z_loan_mut(config), Z_CONFIG_MODE_KEY, "client");
    zp_config_insert(z_loan_mut(config), Z_CONFIG_CONNECT_KEY, given[1]);
    z_owned_session_t zenoh;
    if (z_open(&zenoh, z_move(config), NULL) < 0) return fail("Nobody listens at ENDPOINT: see corrector.json of the server.");
    if (zp_start_read_task(z_loan_mut(zenoh), NULL) < 0 || zp_start_lease_task(z_loan_mut(zenoh), NULL) < 0)
        return fail("zenoh-pico could not start its threads.");

    z_view_keyexpr_t key;
    z_owned_closure_sample_t call;
    z_owned_subscriber_t of_answers, of_versions;
    z_view_keyexpr_from_str(&key, out);
    z_closure(&call, on_answer, NULL, NULL);
    if (z_declare_subscriber(z_loan(zenoh), &of_answers, z_loan(key), z_move(call), NULL) < 0) return fail("No subscriber.");
    z_view_keyexpr_from_str(&key, how.key);
    z_closure(&call, on_announcement, NULL, NULL);
    if (z_declare_subscriber(z_loan(zenoh), &of_versions, z_loan(key), z_move(call), NULL) < 0) return fail("No subscriber.");
    z_owned_publisher_t way;
    z_publisher_options_t urgent;
    z_publisher_options_default(&urgent);
    urgent.priority = Z_PRIORITY_REAL_TIME;
    urgent.is_express = true;  /* never waits to be sent with others */
    urgent.congestion_control = Z_CONGESTION_CONTROL_DROP;
    z_view_keyexpr_from_str(&key, in);
    if (z_declare_publisher(z_loan(zenoh), &way, z_loan(key), &urgent) < 0) return fail("No publisher.");

    how.zenoh = z_loan(zenoh);
    pthread_t thread;
    pthread_create(&thread, NULL, ask_versions, &how);
    loop.seq = random_bits(62);
    loop.clock_offset = random_bits(40);
    loop.since = HOLD_CYCLES + FADE_CYCLES; /* nothing to hold yet */
    run(z_loan(way), atol(given[8]), (uint64_t)atol(given[9]) * 1000u);

    pthread_mutex_lock(&announced.lock);
    announced.stop = 1;
    pthread_cond_signal(&announced.asked);
    pthread_mutex_unlock(&announced.lock);
    pthread_join(thread, NULL);
    z_drop(z_move(way));
    z_drop(z_move(of_answers));
    z_drop(z_move(of_versions));
    z_drop(z_move(zenoh));
    return 0;
}
