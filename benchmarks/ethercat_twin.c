/* The exchange of the driver `ethercat` in C: take what came, judge and decode it, encode the outputs, send.
 *
 * And what times both: one exchange of each in every period, half a period apart.
 */

#define _GNU_SOURCE
#include <math.h>
#include <stdint.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/uio.h>
#include <time.h>

#define MOST_BYTES 1514
#define BATCH 8
#define OPERATIONAL 8

struct number {
    int64_t at, size, is_signed;
    double scale, low, high;
};

struct twin {
    int64_t descriptor, length, count_at, working_counter_at, working_counter, status_at, terminals;
    int64_t inputs, outputs, count, good, received_ns;
    struct number input[48], output[8];
    double value[48], given[8], step;
    uint8_t expected[MOST_BYTES], fixed[MOST_BYTES], sent[MOST_BYTES], received[BATCH][MOST_BYTES];
};

typedef int32_t exchange_function(void *, const double *, void *, int64_t, int64_t);

static int64_t read_clock(clockid_t which)
{
    struct timespec now;
    clock_gettime(which, &now);
    return now.tv_sec * INT64_C(1000000000) + now.tv_nsec;
}

static uint64_t bits(const uint8_t *data, int64_t size)
{
    uint64_t found = 0;
    for (int64_t i = size - 1; i >= 0; i--)
        found = found << 8 | data[i];
    return found;
}

static int is_frame(const struct twin *t, const uint8_t *data, int64_t length)
{
    if (length != t->length)
        return 0;
    for (int64_t i = 0; i < length; i++)
        if (t->fixed[i] && data[i] != t->expected[i])
            return 0;
    return bits(data + t->working_counter_at, 2) == (uint64_t)t->working_counter
        && bits(data + t->status_at + 2, 2) == (uint64_t)t->terminals && (data[t->status_at] & 0x1f) == OPERATIONAL;
}

static void take(struct twin *t, const uint8_t *data)
{
    for (int64_t i = 0; i < t->inputs; i++) {
        const struct number *n = &t->input[i];
        uint64_t code = bits(data + n->at, n->size);
        int shift = 64 - 8 * (int)n->size;
        t->value[i] = n->scale * (n->is_signed ? (double)((int64_t)(code << shift) >> shift) : (double)code);
    }
    t->good++;
}

static void receive(struct twin *t)
{
    struct mmsghdr messages[BATCH];
    struct iovec buffers[BATCH];
    char control[BATCH][CMSG_SPACE(sizeof(struct timespec))];
    memset(messages, 0, sizeof messages);
    for (int k = 0; k < BATCH; k++) {
        buffers[k] = (struct iovec){t->received[k], MOST_BYTES};
        messages[k].msg_hdr = (struct msghdr){
            .msg_iov = &buffers[k], .msg_iovlen = 1, .msg_control = control[k], .msg_controllen = sizeof control[k]};
    }
    int count = recvmmsg((int)t->descriptor, messages, BATCH, MSG_DONTWAIT, NULL);
    int64_t now_ns = read_clock(CLOCK_MONOTONIC), wall_ns = read_clock(CLOCK_REALTIME);
    for (int k = 0; k < count; k++) {
        const struct cmsghdr *stamp = CMSG_FIRSTHDR(&messages[k].msg_hdr);
        struct timespec at;
        t->received_ns = now_ns;
        if (stamp && stamp->cmsg_type == SCM_TIMESTAMPNS) {
            memcpy(&at, CMSG_DATA(stamp), sizeof at);
            t->received_ns -= wall_ns - (at.tv_sec * INT64_C(1000000000) + at.tv_nsec);
        }
        if (is_frame(t, t->received[k], messages[k].msg_len))
            take(t, t->received[k]);
    }
}

static void give(struct twin *t, const double *outputs)
{
    uint32_t count = (uint32_t)t->count++;
    memcpy(t->sent + t->count_at, &count, sizeof count);
    for (int64_t i = 0; i < t->outputs; i++) {
        const struct number *n = &t->output[i];
        double value = fmin(fmax(outputs[i], t->given[i] - t->step), t->given[i] + t->step);
        if (isfinite(value) && value >= n->low && value <= n->high)
            t->given[i] = value;
        int64_t code = (int64_t)nearbyint(t->given[i] / n->scale);
        memcpy(t->sent + n->at, &code, (size_t)n->size);
    }
    send((int)t->descriptor, t->sent, (size_t)t->length, MSG_DONTWAIT | MSG_NOSIGNAL);
}

static void exchange(struct twin *t, const double *outputs)
{
    receive(t);
    give(t, outputs);
}

static void sleep_until(int64_t time_ns)
{
    struct timespec until = {time_ns / 1000000000, time_ns % 1000000000};
    clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, NULL);
}

/* `took` gets processor time (ns) of ours and of the twin's exchange, in turns. */
void run(exchange_function *ours, void *context, void *signals, struct twin *t, const double *outputs, int64_t cycles,
         int64_t period_ns, int64_t *took)
{
    int64_t deadline_ns = read_clock(CLOCK_MONOTONIC) + period_ns;
    for (int64_t k = 0; k < cycles; k++, deadline_ns += period_ns) {
        sleep_until(deadline_ns);
        int64_t begin_ns = read_clock(CLOCK_THREAD_CPUTIME_ID);
        ours(context, outputs, signals, deadline_ns, 1);
        took[2 * k] = read_clock(CLOCK_THREAD_CPUTIME_ID) - begin_ns;
        sleep_until(deadline_ns + period_ns / 2);
        begin_ns = read_clock(CLOCK_THREAD_CPUTIME_ID);
        exchange(t, outputs);
        took[2 * k + 1] = read_clock(CLOCK_THREAD_CPUTIME_ID) - begin_ns;
    }
}
