/* One cycle of the whole cell in plain C: sensors, what is watched, commands, states, axes, outputs. */
#ifndef TWIN_CELL_H
#define TWIN_CELL_H

#include "twin_figures.h"

static void read_lines(const struct cell_parameters *p, struct cell_state *s, const struct signal *signals, int64_t now_ns)
{
    read_line(&p->enable, &s->enable, signals, now_ns);
    read_line(&p->interlock, &s->interlock, signals, now_ns);
    read_line(&p->retracted, &s->retracted, signals, now_ns);
}

static bool is_moving(const struct cell_state *s)
{
    return s->state == ARMING || s->state == TRACKING || s->state == HOLDING || s->state == RAMPING;
}

static void watch_cell(const struct cell_parameters *p, struct cell_state *s)
{
    bool moving = is_moving(s), closed = moving && !(s->state == RAMPING && !s->soft);
    bool enabled = moving && !(s->state == ARMING && s->phase == PARKED);

    cell_fault(p, s, ENABLE_LOST, moving && is_missing(&p->enable, &s->enable), 0.0, 1.0);
    cell_fault(p, s, INTERLOCK_OPEN, closed && is_missing(&p->interlock, &s->interlock), 0.0, 1.0);
    for (int i = 0; i < p->axes; i++)
        watch_axis(p, s, i, closed, enabled);
}

static void begin_arming(const struct cell_parameters *p, struct cell_state *s)
{
    static const struct figures none = {0};

    s->resumed = s->state == HOLDING;
    if (!s->resumed) {
        plan_checks(p, s);
        for (int i = 0; i < p->axes; i++)
            start_axis(&p->axis[i], &s->axis[i]);
    }
    for (int i = 0; i < p->axes; i++) {
        s->axis[i].closed = 0;
        s->axis[i].figures = none;
    }
    enter(s, ARMING);
}

static bool apply_command(const struct cell_parameters *p, struct cell_state *s, int64_t command)
{
    int64_t state = s->state;

    switch (command) {
    case ARM:
        if (refuse(p, s))
            return false;
        begin_arming(p, s);
        return true;
    case HOLD:
        if (state == TRACKING || (state == ARMING && s->phase == CLOSED))
            begin_hold(p, s);
        else if (state != HOLDING)
            return false;
        return true;
    case STOP:
        s->stopping = 1;
        /* fall through */
    case DISARM:
        if (state == TRACKING)
            begin_soft_stop(p, s);
        else if (state == ARMING || state == HOLDING)
            begin_ramp(p, s);
        else if (command == DISARM && state != READY)
            return false;
        return true;
    case RESET:
        if (state != FAULT || s->stopping || s->link_down || s->outputs_taken)
            return false;
        forget(p, s);
        enter(s, READY);
        return true;
    default:
        return true;
    }
}

/* Where the checks of a kind have ended: every answer inside what is expected, or a fault. */
static void judge_checks(const struct cell_parameters *p, struct cell_state *s, int phase)
{
    int64_t was = s->phase;

    if (s->state != ARMING || phase == was || (was != CHECKING_GAUGE && was != CHECKING_STAGE))
        return;
    for (int i = 0; i < p->axes; i++) {
        const struct axis_parameters *axis = &p->axis[i];
        struct axis_state *a = &s->axis[i];
        const struct check_parameters *limits = was == CHECKING_STAGE ? &axis->stage_check : &axis->strain_check;
        struct check_state *c = was == CHECKING_STAGE ? &a->stage_check : &a->strain_check;
        if (c->turn == 0)
            continue;
        c->found = answer(c, limits->step);
        c->passed = limits->low <= c->found && c->found <= limits->high;
        double nearest = c->found > limits->high ? limits->high : limits->low;
        axis_fault(p, s, i, was == CHECKING_STAGE ? STAGE_CHECK : STRAIN_CHECK, !c->passed, c->found, nearest);
    }
}

static void end_arming(const struct cell_parameters *p, struct cell_state *s, int i, int64_t code, double value,
                       double limit)
{
    s->axis[i].watch.raised |= INT64_C(1) << code;
    raise_fault(p, s, code, i, value, limit, later(RAMPS, p->axis[i].watch.reaction[code]));
}

/* End an arming that lacks a sensor, before an outer loop is closed or a reference followed. */
static void watch_arming(const struct cell_parameters *p, struct cell_state *s, int phase)
{
    bool closing = phase == CLOSED && s->phase != CLOSED;

    if (s->state != ARMING || s->resumed || (phase == CLOSED && !closing))
        return;
    for (int i = 0; i < p->axes; i++) {
        const struct axis_parameters *axis = &p->axis[i];
        const struct axis_state *a = &s->axis[i];
        const struct watch_parameters *limits = &axis->watch;
        int64_t samples = earlier(limits->stage_samples, 20) + (closing ? 0 : limits->coast_cycles);
        int64_t code = stage_loss(axis, a, samples, closing), silent = a->reference.silent;
        if (code == STAGE_STUCK) {
            end_arming(p, s, i, code, (double)a->stage.identical, (double)limits->stage_identical);
        } else if (code != NO_FAULT || (closing && !a->estimator.running)) {
            int64_t silent_cycles = (int64_t)((double)a->stage.silent_ns * axis->cycles_per_ns);
            end_arming(p, s, i, STAGE_INVALID, (double)later(a->stage.bad, silent_cycles), (double)samples);
        }
        if (closing && axis->reference.kind == SIGNAL && silent >= limits->lost_cycles)
            end_arming(p, s, i, REFERENCE_LOST, (double)silent, (double)limits->lost_cycles);
    }
}

#define BIT(code) (INT64_C(1) << (code))

/* The checks count no more after whatever could have changed their answer. */
static void keep_checks(const struct cell_parameters *p, struct cell_state *s)
{
    const int64_t cell = BIT(DRIVER_ERROR) | BIT(LINK_LOST);
    const int64_t gauge =
        BIT(STRAIN_INVALID) | BIT(STRAIN_STUCK) | BIT(DISAGREEMENT) | BIT(AMPLIFIER_FAULT) | BIT(STRAIN_CHECK);
    const int64_t stage = BIT(STAGE_INVALID) | BIT(STAGE_STUCK) | BIT(STAGE_CHECK);
    bool changed = s->link_down || s->raised & cell;
    int64_t away_ns = BELIEVED * p->period_ns;

    for (int i = 0; i < p->axes; i++) {
        struct axis_state *a = &s->axis[i];
        int64_t raised = a->watch.raised;
        if (changed || raised & gauge || a->strain.bad >= BELIEVED || is_silent(&a->strain, away_ns))
            a->strain_check.passed = a->stage_check.passed = 0;
        else if (raised & stage || is_silent(&a->stage, away_ns))
            a->stage_check.passed = 0;
    }
}

static void decay_hold(const struct cell_parameters *p, struct cell_state *s)
{
    bool decays = s->state == HOLDING && s->fault == REFERENCE_LOST;
    double passed = (double)(s->cycle - s->entered_cycle);

    for (int i = 0; i < p->axes; i++)
        s->axis[i].hold_scale = decays ? 1.0 - smooth(passed / (double)p->axis[i].watch.decay_cycles) : 1.0;
}

static bool asks_feed_hold(const struct cell_state *s) { return s->state == HOLDING || s->fault != NO_FAULT; }

static void switch_outputs(const struct cell_parameters *p, const struct cell_state *s, double *outputs)
{
    if (p->amplifier_enable >= 0)
        outputs[p->amplifier_enable] = is_moving(s) ? 1.0 : 0.0;
    if (p->feed_hold >= 0)
        outputs[p->feed_hold] = asks_feed_hold(s) ? 1.0 : 0.0;
    if (p->heartbeat >= 0)
        outputs[p->heartbeat] = (double)(s->cycle / p->heartbeat_cycles % 2);
}

static bool cell_cycle(const struct cell_parameters *p, struct cell_state *s, const struct signal *signals, double *outputs,
                       int64_t command, int64_t now_ns, int64_t periods)
{
    double fraction;

    pass_missed(s, periods - 1);
    s->cycle++;
    for (int i = 0; i < p->axes; i++)
        sample(&p->axis[i], &s->axis[i], signals, now_ns);
    read_lines(p, s, signals, now_ns);
    watch_cell(p, s);
    bool accepted = command == NO_COMMAND || apply_command(p, s, command);
    finish_phase(p, s, is_on(&p->retracted, &s->retracted));
    int phase = phase_of(p, s, &fraction);
    if (s->state == ARMING) {
        judge_checks(p, s, phase);
        watch_arming(p, s, phase);
        phase = phase_of(p, s, &fraction);
        fraction = arming_step(p, s, phase, fraction);
    }
    decay_hold(p, s);
    s->phase = phase;
    bool tracks = s->state == TRACKING || (s->state == RAMPING && s->soft);
    for (int i = 0; i < p->axes; i++) {
        const struct axis_parameters *axis = &p->axis[i];
        struct axis_state *a = &s->axis[i];
        int own = s->state == HOLDING && a->frozen ? FROZEN : phase;
        a->reference.followed = own == CLOSED && s->state != HOLDING;
        bool finite = axis_cycle(axis, a, s->cycle, now_ns, tracks, own, fraction);
        axis_fault(p, s, i, NOT_FINITE, !finite, a->setpoint_um, NAN);
        outputs[axis->voltage] = a->voltage_V;
        if (s->state == TRACKING && s->cycle - s->tracking_cycle >= p->score_cycles)
            score(a, signals[axis->path_error].value, signals[axis->uncompensated].value);
        if (s->state == TRACKING)
            mean_squares(p, a);
    }
    keep_checks(p, s);
    switch_outputs(p, s, outputs);
    return accepted;
}

#endif
