/* The Kalman filter of one axis in plain C: x <- A x + B u in every cycle, corrected by a sample at its own cycle. */
#ifndef TWIN_ESTIMATOR_H
#define TWIN_ESTIMATOR_H

#include <math.h>
#include <stdbool.h>

#include "records.h"

#define HISTORY_MASK (INPUT_HISTORY - 1)

/* Python's min and max: the first of two that do not compare. */
static inline double least(double a, double b) { return b < a ? b : a; }
static inline double most(double a, double b) { return b > a ? b : a; }
static inline int64_t earlier(int64_t a, int64_t b) { return a < b ? a : b; }
static inline int64_t later(int64_t a, int64_t b) { return a > b ? a : b; }

static void predict(const struct outer_parameters *p, double *restrict x, double u)
{
    double next[MAX_STATES];
    int padded = (int)(p->states + 3) / 4 * 4;    /* the padding is zero and stays zero */

    for (int i = 0; i < padded; i++)
        next[i] = p->b[i] * u;
    for (int j = 0; j < p->states; j++)
        for (int i = 0; i < padded; i++)
            next[i] += p->a_columns[j][i] * x[j];
    for (int i = 0; i < padded; i++)
        x[i] = next[i];
}

static double output(const struct outer_parameters *p, const double *x)
{
    double y = 0.0;

    for (int i = 0; i < p->states; i++)
        y += p->c[i] * x[i];
    return y;
}

static void advance(const struct outer_parameters *p, const double *history, double *x, int64_t first, int64_t last)
{
    for (int64_t cycle = first; cycle < last; cycle++)
        predict(p, x, history[cycle & HISTORY_MASK]);
}

static void start_estimator(const struct outer_parameters *p, struct estimator_state *s, int64_t cycle, double u, double y)
{
    for (int i = 0; i < p->states; i++)
        s->x[i] = s->filtered[i] = p->steady_u[i] * u + p->steady_y[i] * y;
    for (int k = 0; k < INPUT_HISTORY; k++)
        s->history[k] = u;
    s->filtered_cycle = s->cycle = cycle;
    s->innovation_um = s->opened_um = 0.0;
    s->reading_um = y;
    s->repeated = 0;
    s->running = 1;
}

static void predict_to(const struct outer_parameters *p, struct estimator_state *s, int64_t cycle)
{
    double held = s->history[s->cycle & HISTORY_MASK];

    for (int64_t skipped = s->cycle + 1; skipped < earlier(cycle, s->cycle + INPUT_HISTORY); skipped++)
        s->history[skipped & HISTORY_MASK] = held;
    advance(p, s->history, s->x, later(s->cycle, cycle - INPUT_HISTORY + 1), cycle);
    s->cycle = cycle;
}

/* No more of an innovation than is plausible at once; while more comes the limit opens, and closes slowly again. */
static double believed(const struct outer_parameters *p, struct estimator_state *s, double innovation)
{
    double limit_um = p->innovation_um + s->opened_um;

    if (s->repeated >= 2)
        limit_um = p->repeated_um;
    double applied = most(-limit_um, least(limit_um, innovation));
    s->opened_um = most(2.0 * fabs(applied), 0.9 * s->opened_um);
    return applied;
}

static void update(const struct outer_parameters *p, struct estimator_state *s, int64_t sample_cycle, double y)
{
    int64_t now = s->cycle;
    int n = (int)p->states;
    bool gap = sample_cycle - s->filtered_cycle > p->gap_cycles;

    if (sample_cycle <= s->filtered_cycle || sample_cycle > now || now - sample_cycle >= INPUT_HISTORY)
        return;
    if (now - s->filtered_cycle >= INPUT_HISTORY) {
        start_estimator(p, s, now, s->history[(now - 1) & HISTORY_MASK], y);
        return;
    }
    s->repeated = y == s->reading_um ? s->repeated + 1 : 0;
    s->reading_um = y;
    if (sample_cycle == now)
        for (int i = 0; i < n; i++)
            s->filtered[i] = s->x[i];
    else
        advance(p, s->history, s->filtered, s->filtered_cycle, sample_cycle);
    s->innovation_um = y - output(p, s->filtered);
    double applied = believed(p, s, s->innovation_um);
    for (int i = 0; i < n; i++)
        s->x[i] = s->filtered[i] += p->gain[i] * (gap && i < p->slow ? s->innovation_um : applied);
    advance(p, s->history, s->x, sample_cycle, now);
    s->filtered_cycle = sample_cycle;
}

#endif
