/* One signal of the process image in plain C: fresh or held, how old, plausible or not; digital inputs. */
#ifndef TWIN_SENSOR_H
#define TWIN_SENSOR_H

#include "twin_estimator.h"

enum { BELIEVED = 1000 };   /* unusable cycles in a row after which a reading that jumped away is believed */

static const double any_value[2] = {-INFINITY, INFINITY};

static bool read_signal(const struct signal *signal, struct sensor_state *s, int64_t now_ns, int64_t max_age_ns,
                        const double *range_um, double rate_um_per_ns)
{
    bool arrived = signal->sequence != s->sequence;
    double value = signal->value;
    bool good = signal->status == 0 && isfinite(value) && range_um[0] <= value && value <= range_um[1];

    s->fresh = 0;
    if (arrived) {
        int64_t taken_ns = earlier(signal->time_ns, now_ns);
        if (s->sequence > 0) {
            s->lost += later(0, signal->sequence - s->sequence - 1);
            if (good && isfinite(rate_um_per_ns) && s->bad < BELIEVED)
                good = fabs(value - s->value) <= rate_um_per_ns * (double)later(now_ns - s->arrived_ns, taken_ns - s->taken_ns);
        }
        s->identical = value == s->reading ? s->identical + 1 : 0;
        s->sequence = signal->sequence;
        s->reading = value;
        s->arrived_ns = now_ns;
        s->taken_ns = taken_ns;
        if (good) {
            s->value = value;
            s->time_ns = taken_ns;
            s->fresh = 1;
        }
    }
    s->silent_ns = now_ns - s->arrived_ns;
    s->age_ns = now_ns - s->time_ns;
    if ((arrived && !good) || s->sequence == 0 || s->age_ns > max_age_ns)
        s->bad++;
    else if (arrived)
        s->bad = 0;
    return s->fresh;
}

static bool is_silent(const struct sensor_state *s, int64_t longest_ns)
{
    return s->sequence == 0 || s->silent_ns > longest_ns;
}

/* A number that does not count, or at an end of its range: what it measures may be beyond. */
static bool may_be_at_end(const struct sensor_state *s, const double *range_um)
{
    double margin_um = 0.01 * (range_um[1] - range_um[0]);
    bool inside = range_um[0] + margin_um < s->reading && s->reading < range_um[1] - margin_um;

    return isfinite(s->reading) && (s->bad > 0 || !inside);
}

static inline bool is_wired(const struct line_parameters *line) { return line->signal >= 0; }

static void read_line(const struct line_parameters *line, struct sensor_state *s, const struct signal *signals,
                      int64_t now_ns)
{
    if (is_wired(line))
        read_signal(&signals[line->signal], s, now_ns, line->age_ns, any_value, INFINITY);
}

static bool is_on(const struct line_parameters *line, const struct sensor_state *s)
{
    return is_wired(line) && s->bad == 0 && s->value > 0.5;
}

static bool is_missing(const struct line_parameters *line, const struct sensor_state *s)
{
    return is_wired(line) && !is_on(line, s);
}

#endif
