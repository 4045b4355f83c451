/* What is watched on each axis in plain C: sensors, errors, voltage, oscillation, reference, amplifier. */
#ifndef TWIN_WATCH_H
#define TWIN_WATCH_H

#include "twin_faults.h"

static inline int64_t lasting(int64_t count, bool active) { return active ? count + 1 : 0; }

static void watch_strain(const struct cell_parameters *p, struct cell_state *s, int i, bool active)
{
    const struct watch_parameters *limits = &p->axis[i].watch;
    const struct sensor_state *sensor = &s->axis[i].strain;
    struct watch_state *w = &s->axis[i].watch;
    bool bad = active && sensor->bad >= limits->strain_samples;
    bool stuck = active && sensor->identical >= limits->strain_identical;

    w->coast = lasting(w->coast, bad || stuck);
    bool over = w->coast > limits->coast_cycles;
    double lost = (double)(bad ? sensor->bad : sensor->identical), samples = (double)limits->strain_samples;
    warn(s, i, COASTING, w->coast > 0, lost, samples);
    axis_fault(p, s, i, STRAIN_INVALID, over && bad, lost, samples);
    axis_fault(p, s, i, STRAIN_STUCK, over && stuck, lost, (double)limits->strain_identical);
}

static void watch_stage(const struct cell_parameters *p, struct cell_state *s, int i, bool active)
{
    const struct watch_parameters *limits = &p->axis[i].watch;
    const struct sensor_state *sensor = &s->axis[i].stage;
    struct watch_state *w = &s->axis[i].watch;
    bool bad = active && sensor->bad >= limits->stage_samples;
    bool stuck = active && sensor->identical >= limits->stage_identical;

    if (w->degraded > limits->bridged_cycles && !(bad || stuck))
        s->axis[i].closed = 0;
    w->degraded = lasting(w->degraded, bad || stuck);
    bool over = w->degraded > limits->degraded_cycles;
    double lost = (double)(bad ? sensor->bad : sensor->identical), samples = (double)limits->stage_samples;
    warn(s, i, DEGRADED, w->degraded > 0, lost, samples);
    axis_fault(p, s, i, STAGE_INVALID, over && bad, lost, samples);
    axis_fault(p, s, i, STAGE_STUCK, over && stuck, lost, (double)limits->stage_identical);
}

static void watch_innovation(const struct cell_parameters *p, struct cell_state *s, int i, bool active)
{
    const struct watch_parameters *limits = &p->axis[i].watch;
    struct axis_state *a = &s->axis[i];
    struct watch_state *w = &a->watch;

    if (!active) {
        w->innovation = 1.0;
    } else if (a->stage.fresh && w->degraded == 0) {
        double square = a->estimator.innovation_um * a->estimator.innovation_um / limits->innovation_variance;
        w->innovation += limits->innovation_step * (square - w->innovation);
    }
    bool disagree = active && w->innovation > limits->innovation_ratio;
    if (disagree && limits->reaction[DISAGREEMENT] == HOLDS)
        a->frozen = 1;
    axis_fault(p, s, i, DISAGREEMENT, disagree, w->innovation, limits->innovation_ratio);
}

static void watch_following(const struct cell_parameters *p, struct cell_state *s, int i, bool active)
{
    const struct watch_parameters *limits = &p->axis[i].watch;
    const struct axis_state *a = &s->axis[i];
    struct watch_state *w = &s->axis[i].watch;
    bool known = active && w->degraded == 0 && w->coast == 0;
    double error_um = fabs(a->stage_error_um);

    w->following = lasting(w->following, known && error_um > limits->following_um);
    bool over = w->following >= limits->following_cycles;
    axis_fault(p, s, i, FOLLOWING_ERROR, over, error_um, limits->following_um);
}

static void watch_voltage(const struct cell_parameters *p, struct cell_state *s, int i, bool active)
{
    const struct watch_parameters *limits = &p->axis[i].watch;
    const struct limiter_parameters *limiter = &p->axis[i].limiter;
    const struct axis_state *a = &s->axis[i];
    struct watch_state *w = &s->axis[i].watch;
    bool at_end = active && (a->request_V > limiter->high_V || a->request_V < limiter->low_V);

    w->saturated = lasting(w->saturated, at_end);
    bool early = w->saturated >= limits->saturating_cycles, over = w->saturated >= limits->saturated_cycles;
    warn(s, i, SATURATING, early, a->voltage_V, (double)limits->saturating_cycles);
    axis_fault(p, s, i, SATURATED, over, a->voltage_V, (double)limits->saturated_cycles);
}

static double band_pass(const struct watch_parameters *limits, struct watch_state *w, double x)
{
    const double *b = limits->band_b;
    double y = b[0] * x + b[1] * w->band_x1 + b[2] * w->band_x2;

    y -= limits->band_a1 * w->band_y1 + limits->band_a2 * w->band_y2;
    w->band_x2 = w->band_x1;
    w->band_x1 = x;
    w->band_y2 = w->band_y1;
    w->band_y1 = y;
    return y;
}

static void watch_oscillation(const struct cell_parameters *p, struct cell_state *s, int i, bool active)
{
    const struct watch_parameters *limits = &p->axis[i].watch;
    struct axis_state *a = &s->axis[i];
    struct watch_state *w = &a->watch;

    if (!active) {
        w->band_x1 = w->band_x2 = w->band_y1 = w->band_y2 = w->band_energy = 0.0;
        w->band_cycles = w->fallback = 0;
    } else if (a->error_fresh) {
        double y = band_pass(limits, w, a->strain_error_um);
        w->band_energy += limits->band_step * (y * y - w->band_energy);
    }
    double rms_um = sqrt(w->band_energy);
    w->band_cycles = lasting(w->band_cycles, rms_um > limits->band_um);
    bool swings = w->band_cycles >= limits->band_cycles;
    if (swings && !w->fallback) {
        retune_pid(&p->axis[i].pid, &p->axis[i].fallback, &a->pid);
        w->fallback = 1;
        w->band_cycles = 0;
        swings = false;
    }
    warn(s, i, FALLBACK, w->fallback, rms_um, limits->band_um);
    axis_fault(p, s, i, OSCILLATION, swings, rms_um, limits->band_um);
}

static void watch_reference(const struct cell_parameters *p, struct cell_state *s, int i, bool active)
{
    const struct watch_parameters *limits = &p->axis[i].watch;
    int64_t silent = s->axis[i].reference.silent;
    bool follows = active && p->axis[i].reference.kind == SIGNAL;
    bool stale = follows && silent >= limits->stale_cycles, lost = follows && silent >= limits->lost_cycles;

    warn(s, i, REFERENCE_STALE, stale, (double)silent, (double)limits->stale_cycles);
    axis_fault(p, s, i, REFERENCE_LOST, lost, (double)silent, (double)limits->lost_cycles);
}

static void watch_amplifier(const struct cell_parameters *p, struct cell_state *s, int i, bool active)
{
    const struct axis_parameters *axis = &p->axis[i];
    struct axis_state *a = &s->axis[i];
    int64_t *hot = &a->watch.hot, hot_cycles = axis->watch.hot_cycles;

    axis_fault(p, s, i, AMPLIFIER_FAULT, active && is_missing(&axis->amplifier_ok, &a->amplifier_ok), 0.0, 1.0);
    *hot = lasting(*hot, active && is_missing(&axis->temperature_ok, &a->temperature_ok));
    warn(s, i, DERATED, *hot > 0, 100.0 * axis->watch.derate, 100.0);
    axis_fault(p, s, i, OVER_TEMPERATURE, *hot > hot_cycles, (double)*hot, (double)hot_cycles);
}

static int64_t sensor_end(const struct sensor_state *sensor, const double *range_um)
{
    double reading = sensor->reading;

    if (reading >= range_um[1])
        return 1;
    if (reading <= range_um[0])
        return -1;
    if (sensor->bad < 2 || !sensor->identical || reading == sensor->value)
        return 0;
    return reading > sensor->value ? 1 : -1;
}

static bool swings(const struct watch_parameters *limits, struct swing *w, int64_t cycle, int64_t end)
{
    if (end && end != w->end) {
        if (w->end) {
            if (!w->times || cycle - w->first_cycle > limits->swing_cycles) {
                w->times = 0;
                w->first_cycle = cycle;
            }
            w->times++;
        }
        w->end = end;
    }
    return w->times >= limits->swings;
}

static void watch_swing(const struct cell_parameters *p, struct cell_state *s, int i, bool active)
{
    const struct axis_parameters *axis = &p->axis[i];
    const struct axis_state *a = &s->axis[i];
    struct watch_state *w = &s->axis[i].watch;
    struct swing *all[] = {&w->driven_swing, &w->strain_swing, &w->stage_swing};
    bool up = a->voltage_V >= axis->limiter.high_V || a->setpoint_um >= axis->setpoint_high_um;
    bool down = a->voltage_V <= axis->limiter.low_V || a->setpoint_um <= axis->setpoint_low_um;
    int64_t ends[] = {
        up - down,
        sensor_end(&a->strain, axis->strain_range_um),
        sensor_end(&a->stage, axis->stage_range_um),
    };
    int64_t since = s->cycle;
    bool found = false;

    for (int k = 0; k < 3; k++) {
        if (!active) {
            all[k]->end = all[k]->times = 0;
        } else if (swings(&axis->watch, all[k], s->cycle, ends[k])) {
            since = all[k]->first_cycle;
            found = true;
        }
    }
    double lasted_s = (double)((s->cycle - since) * p->period_ns) * 1e-9;
    axis_fault(p, s, i, LIMIT_CYCLE, found, lasted_s, (double)axis->watch.swings);
}

static void watch_axis(const struct cell_parameters *p, struct cell_state *s, int i, bool moving, bool enabled)
{
    int64_t phase = s->phase;
    bool inner = moving && (phase == LIFTING || phase == CHECKING_STAGE || phase == SWEEPING || phase == CLOSED);
    bool outer = moving && phase == CLOSED, tracking = moving && s->state == TRACKING;

    watch_strain(p, s, i, inner);
    watch_stage(p, s, i, outer);
    watch_innovation(p, s, i, outer);
    watch_following(p, s, i, tracking);
    watch_voltage(p, s, i, inner);
    watch_oscillation(p, s, i, inner);
    watch_swing(p, s, i, inner);
    watch_reference(p, s, i, tracking);
    watch_amplifier(p, s, i, enabled);
}

#endif
