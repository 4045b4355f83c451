/* The other laws of one axis in plain C: tracker, jog, state feedback, feedforward, PID, limiter.
 *
 * What micromanip/rt does, for what config/simulated.yaml uses: stage control after a tracker (or a jog), with a
 * Prandtl-Ishlinskii model and tanh shaping. Lengths in um, voltages in V.
 */
#ifndef TWIN_LAWS_H
#define TWIN_LAWS_H

#include "twin_estimator.h"

/* Tracker: position, velocity, acceleration and oscillation, extrapolated in closed form. */

static void extrapolate(const double *restrict from, double omega, double tau_s, double *restrict to)
{
    double sine = sin(omega * tau_s), cosine = cos(omega * tau_s);

    to[0] = from[0] + tau_s * (from[1] + 0.5 * tau_s * from[2]);
    to[1] = from[1] + tau_s * from[2];
    to[2] = from[2];
    to[3] = cosine * from[3] + sine / omega * from[4];
    to[4] = -omega * sine * from[3] + cosine * from[4];
}

static void tracker_sample(const struct reference_parameters *p, struct reference_state *s, double value, int64_t time_ns)
{
    double gap_s = (double)(time_ns - s->time_ns) * 1e-9, innovation = NAN;

    if (!(isfinite(value) && p->low_um <= value && value <= p->high_um)) {
        s->rejected++;
        return;
    }
    if (s->time_ns != 0 && gap_s <= 0.0)
        return;
    if (s->time_ns != 0 && gap_s <= p->horizon_s) {
        extrapolate(s->filtered, p->oscillator, gap_s, s->w);
        innovation = value - s->w[0] - s->w[3];
    }
    bool lost = s->followed && !isfinite(innovation);
    double jump_um = isfinite(innovation) ? innovation : lost ? value - s->sampled_um : 0.0;
    if (fabs(jump_um) > p->jump_um || (lost && s->doubted)) {
        s->rejected++;
        s->doubted = 1;
        return;
    }
    s->silent = s->doubted = 0;
    if (isfinite(innovation)) {
        for (int i = 0; i < REFERENCE_STATES; i++)
            s->filtered[i] = s->w[i] + p->gain[i] * innovation;
    } else {    /* the first sample, the first after a gap, or a memory that was lost */
        for (int i = 0; i < REFERENCE_STATES; i++)
            s->filtered[i] = 0.0;
        s->filtered[0] = value;
    }
    s->sampled_um = value;
    s->time_ns = time_ns;
}

static void hold_position(struct reference_state *s, double position_um)
{
    for (int i = 0; i < REFERENCE_STATES; i++)
        s->w[i] = 0.0;
    s->w[0] = position_um;
}

static void tracker_reference(const struct reference_parameters *p, struct reference_state *s, int64_t now_ns)
{
    double age_s = (double)(now_ns - s->time_ns) * 1e-9;

    if (p->predict && s->time_ns > 0 && age_s <= p->horizon_s)
        extrapolate(s->filtered, p->oscillator, age_s, s->w);
    else
        hold_position(s, s->sampled_um);
}

static void jog_reference(const struct reference_parameters *p, struct reference_state *s, bool moves)
{
    double wanted = moves ? p->target_um - s->jog_um : 0.0;
    double step = most(-p->speed_um, least(p->speed_um, 0.25 * p->smoothing * wanted));

    s->jog_step_um += p->smoothing * (step - s->jog_step_um);
    s->jog_um += s->jog_step_um;
    hold_position(s, s->jog_um);
}

static double outer_setpoint(const struct outer_parameters *p, const double *x, const double *w)
{
    double u = 0.0;

    for (int i = 0; i < REFERENCE_STATES; i++)
        u += p->reference[i] * w[i];
    for (int i = 0; i < p->states; i++)
        u -= p->feedback[i] * x[i];
    return u;
}

/* Inverse hysteresis: creep taken off, play operators, the inverse of c0 tanh(c1 v + c2) + c3. */

static double play(double x, double r, double w) { return most(x - r, least(x + r, w)); }

static double feedforward_voltage(const struct hysteresis_parameters *p, struct hysteresis_state *s, double setpoint_um)
{
    const double *c = p->shaping.c, open_interval = 1.0 - 1e-12;
    double y = most(p->low_um, least(p->high_um, setpoint_um));
    double widening = p->alpha * p->rate_cycles * fabs(s->change_um);

    for (int m = 0; m < p->creeps; m++)
        y -= p->creep_gain[m] * s->creep_um[m];
    double u = y / p->alpha;
    for (int i = 0; i < p->plays; i++) {
        s->z[i] = play(y, p->r_hat[i] + widening, s->z[i]);
        u += p->rho_hat[i] * s->z[i];
    }
    for (int m = 0; m < p->creeps; m++)
        s->creep_um[m] += p->creep_step[m] * (u - s->creep_um[m]);
    s->change_um = u - s->u_um;
    s->u_um = u;
    double ratio = most(-open_interval, least(open_interval, (u - c[3]) / c[0]));
    s->output_V = (atanh(ratio) - c[2]) / c[1];
    return s->output_V;
}

static void start_feedforward(const struct hysteresis_parameters *p, struct hysteresis_state *s, double y_um, double v)
{
    const double *c = p->shaping.c;
    double y = most(p->low_um, least(p->high_um, y_um));
    double u = c[0] * tanh(c[1] * v + c[2]) + c[3];

    for (int m = 0; m < p->creeps; m++) {
        s->creep_um[m] = u;
        y -= p->creep_gain[m] * u;
    }
    double inner = y, r_inner = 0.0;
    for (int i = 0; i < p->plays; i++) {
        inner = s->z[i] = play(inner, p->r_hat[i] - r_inner, s->z[i]);
        r_inner = p->r_hat[i];
    }
    s->u_um = u;
    s->change_um = 0.0;
    s->y_memory = y;
    s->v_memory = v;
    s->y_last = s->y_extreme = y;
    s->v_last = v;
    s->direction = 0.0;
}

static void pid_step(const struct pid_parameters *p, struct pid_state *s, double error_um, int64_t periods)
{
    double elapsed_s = (double)periods * p->period_s;

    s->derivative = (p->filter_s * s->derivative + p->derivative * (error_um - s->error)) / (p->filter_s + elapsed_s);
    s->integrator += p->integral * (double)periods * error_um;
    s->error = error_um;
    s->output_V = p->gain * error_um + s->integrator + s->derivative;
}

static void retune_pid(const struct pid_parameters *old, const struct pid_parameters *new, struct pid_state *s)
{
    s->integrator += (old->gain - new->gain) * s->error;
    if (old->derivative != new->derivative || old->filter_s != new->filter_s) {
        s->integrator += s->derivative;
        s->derivative = 0.0;
    }
}

static double limit(const struct limiter_parameters *p, double previous_V, double requested_V, bool permitted)
{
    double target = permitted ? requested_V : p->park_V;

    if (!isfinite(previous_V))
        return p->park_V;
    if (!isfinite(target))
        target = previous_V;
    target = most(previous_V - p->slew_V, least(previous_V + p->slew_V, target));
    return most(p->low_V, least(p->high_V, target));
}

#endif
