/* The cycle of one axis in plain C: samples, estimate, set-point, feedforward and feedback, limiter. */
#ifndef TWIN_AXIS_H
#define TWIN_AXIS_H

#include "twin_laws.h"
#include "twin_sensor.h"

/* Share of the reference that the axis may follow: less while its amplifier is hot. */
static double authority(const struct axis_parameters *p, const struct axis_state *s)
{
    return p->authority * (s->watch.hot > 0 ? p->watch.derate : 1.0);
}

static void start_axis(const struct axis_parameters *p, struct axis_state *s)
{
    s->closed = 0;
    s->frozen = 0;
    s->estimator.running = 0;
    s->strain_cycles = 1;
    s->hold_scale = 1.0;
    s->authority = authority(p, s);
    s->reference.jog_um = p->reference.target_um;
    s->reference.jog_step_um = 0.0;
    s->start_V = s->voltage_V;
    s->setpoint_um = s->start_um = s->strain.value;
    for (int k = 0; k < INPUT_HISTORY; k++) {
        s->setpoints[k] = s->setpoint_um;
        s->references[k] = s->reference.w[0] + s->reference.w[3];
    }
    start_feedforward(&p->hysteresis, &s->hysteresis, s->setpoint_um, s->voltage_V);
    s->pid.derivative = s->pid.error = 0.0;
    s->pid.output_V = s->voltage_V - feedforward_voltage(&p->hysteresis, &s->hysteresis, s->setpoint_um);
    s->pid.integrator = s->pid.output_V;
}

static void remember_wanted(struct axis_state *s, int64_t cycle)
{
    int64_t last = s->wanted_cycle;

    for (int64_t skipped = later(last + 1, cycle - INPUT_HISTORY); skipped < cycle; skipped++) {
        s->setpoints[skipped & HISTORY_MASK] = s->setpoints[last & HISTORY_MASK];
        s->references[skipped & HISTORY_MASK] = s->references[last & HISTORY_MASK];
    }
    s->setpoints[cycle & HISTORY_MASK] = s->setpoint_um;
    s->references[cycle & HISTORY_MASK] = s->reference.w[0] + s->reference.w[3];
    s->wanted_cycle = cycle;
}

/* Where what was wanted when a sample was taken stands: of its cycle, or of the nearest one that is remembered. */
static int64_t wanted_place(const struct axis_parameters *p, const struct axis_state *s, int64_t cycle, int64_t age_ns,
                            int64_t way)
{
    int64_t wanted = cycle - (int64_t)((double)age_ns * p->cycles_per_ns + 0.5) - way;

    return later(s->wanted_cycle - HISTORY_MASK, earlier(s->wanted_cycle, wanted)) & HISTORY_MASK;
}

static double strain_error(const struct axis_parameters *p, const struct axis_state *s, int64_t cycle)
{
    return s->setpoints[wanted_place(p, s, cycle, s->strain.age_ns, p->answer_cycles)] - s->strain.value;
}

/* The errors of a cycle: what the PID acts on, what is watched and what is scored. */
static void measure_errors(const struct axis_parameters *p, struct axis_state *s, int64_t cycle)
{
    s->strain_error_um = strain_error(p, s, cycle);
    s->path_um = s->references[wanted_place(p, s, cycle, s->stage.age_ns, 0)];
    s->stage_error_um = s->path_um - s->stage.value;
    s->error_fresh = s->strain.fresh;
}

static void sample(const struct axis_parameters *p, struct axis_state *s, const struct signal *signals, int64_t now_ns)
{
    s->strain_cycles++;
    s->reference.silent++;
    read_signal(&signals[p->strain], &s->strain, now_ns, p->strain_age_ns, p->strain_range_um, p->strain_rate_um_per_ns);
    read_signal(&signals[p->stage], &s->stage, now_ns, p->stage_age_ns, p->stage_range_um, p->stage_rate_um_per_ns);
    if (read_signal(&signals[p->deviation], &s->deviation, now_ns, p->reference_age_ns, any_value, INFINITY))
        tracker_sample(&p->reference, &s->reference, s->deviation.value, s->deviation.time_ns);
    read_line(&p->amplifier_ok, &s->amplifier_ok, signals, now_ns);
    read_line(&p->temperature_ok, &s->temperature_ok, signals, now_ns);
}

static void estimate(const struct axis_parameters *p, struct axis_state *s, int64_t cycle)
{
    if (!s->estimator.running) {
        if (s->stage.fresh)
            start_estimator(&p->outer, &s->estimator, cycle, s->setpoint_um - p->centre_um, s->stage.value);
        return;
    }
    predict_to(&p->outer, &s->estimator, cycle);
    if (s->stage.fresh && s->watch.degraded == 0) {
        int64_t age = (int64_t)((double)s->stage.age_ns * p->cycles_per_ns + 0.5);
        update(&p->outer, &s->estimator, cycle - age, s->stage.value);
    }
}

static double demand(const struct axis_parameters *p, struct axis_state *s, int phase, double fraction)
{
    double *w = s->reference.w, step = p->authority_step;

    s->authority += most(-step, least(step, authority(p, s) - s->authority));
    if (phase != CLOSED)
        return s->start_um + fraction * (p->centre_um - s->start_um) + s->offset;
    if (!s->estimator.running)
        return s->setpoint_um;
    if (!s->closed)
        s->hold_um = output(&p->outer, s->estimator.x);
    double held = s->hold_scale * s->hold_um;
    w[0] = held + fraction * (s->authority * w[0] - held);
    for (int i = 1; i < REFERENCE_STATES; i++)
        w[i] *= fraction * s->authority;
    double u = p->centre_um + outer_setpoint(&p->outer, s->estimator.x, w);
    if (!s->closed) {
        s->blend_um = s->setpoint_um - u;
        s->closed = 1;
    }
    s->blend_um *= p->blend_decay;
    return u + s->blend_um;
}

static bool move_setpoint(const struct axis_parameters *p, struct axis_state *s, double demand_um)
{
    double step = p->setpoint_slew_um;

    if (!isfinite(demand_um))
        return false;
    double low = least(p->setpoint_low_um, s->setpoint_um), high = most(p->setpoint_high_um, s->setpoint_um);
    double inside = most(low, least(high, demand_um));
    s->setpoint_um = most(s->setpoint_um - step, least(s->setpoint_um + step, inside));
    return true;
}

static double request_voltage(const struct axis_parameters *p, struct axis_state *s)
{
    double feedforward = feedforward_voltage(&p->hysteresis, &s->hysteresis, s->setpoint_um);

    if (s->watch.coast > 0) {
        s->strain_cycles = 0;
    } else if (s->strain.fresh) {
        const struct pid_parameters *gains = s->watch.fallback ? &p->fallback : &p->pid;
        pid_step(gains, &s->pid, s->strain_error_um, s->strain_cycles);
        s->strain_cycles = 0;
    }
    return feedforward + s->pid.output_V;
}

/* Whether every stage of the law is finite: estimate, feedforward, feedback and its memory, requested voltage. */
static bool is_finite(const struct axis_parameters *p, const struct axis_state *s)
{
    double total = s->request_V + s->hysteresis.u_um + s->hysteresis.output_V;

    total += s->pid.output_V + s->pid.integrator + s->pid.derivative;

    for (int i = 0; i < p->outer.states && s->estimator.running; i++)
        total += s->estimator.x[i];
    return isfinite(total);
}

/* Back to park, a step of the check, or no move at all; off its feedback. */
static double open_voltage(const struct axis_parameters *p, const struct axis_state *s, int phase, double fraction)
{
    switch (phase) {
    case FROZEN:
        return s->voltage_V;
    case CHECKING_GAUGE:
        return s->start_V + s->offset;
    default:
        return s->start_V + fraction * (p->limiter.park_V - s->start_V);
    }
}

static bool axis_cycle(const struct axis_parameters *p, struct axis_state *s, int64_t cycle, int64_t now_ns, bool tracks,
                       int phase, double fraction)
{
    if (phase == PARKED || phase == CHECKING_GAUGE || phase == PARKING || phase == FROZEN) {
        measure_errors(p, s, cycle);
        s->request_V = open_voltage(p, s, phase, fraction);
        s->voltage_V = limit(&p->limiter, s->voltage_V, s->request_V, phase != PARKED);
        return isfinite(s->request_V);
    }
    estimate(p, s, cycle);
    if (p->reference.kind == SIGNAL)
        tracker_reference(&p->reference, &s->reference, now_ns);
    else
        jog_reference(&p->reference, &s->reference, tracks);
    bool finite = move_setpoint(p, s, demand(p, s, phase, fraction));
    remember_wanted(s, cycle);
    measure_errors(p, s, cycle);
    s->request_V = request_voltage(p, s);
    finite = finite && is_finite(p, s);
    s->voltage_V = limit(&p->limiter, s->voltage_V, s->request_V, true);
    s->pid.integrator -= p->pid.tracking * (s->request_V - s->voltage_V);
    s->pid.output_V -= p->pid.tracking * (s->request_V - s->voltage_V);
    s->estimator.history[s->estimator.cycle & HISTORY_MASK] = s->setpoint_um - p->centre_um;
    return finite;
}

#endif
