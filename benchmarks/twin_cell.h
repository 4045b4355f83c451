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
    return s->state == ARMED || s->state == TRACKING || s->state == HOLDING || s->state == RAMPING;
}

static void watch_cell(const struct cell_parameters *p, struct cell_state *s)
{
    bool moving = is_moving(s), closed = moving && !(s->state == RAMPING && !s->soft);
    bool enabled = moving && !(s->state == ARMED && s->phase == PARKED);

    cell_fault(p, s, ENABLE_LOST, moving && is_missing(&p->enable, &s->enable), 0.0, 1.0);
    cell_fault(p, s, INTERLOCK_OPEN, closed && is_missing(&p->interlock, &s->interlock), 0.0, 1.0);
    for (int i = 0; i < p->axes; i++)
        watch_axis(p, s, i, closed, enabled);
}

static void begin_arming(const struct cell_parameters *p, struct cell_state *s)
{
    static const struct check_state none = {0};

    s->resumed = s->state == HOLDING;
    for (int i = 0; i < p->axes; i++) {
        if (!s->resumed) {
            start_axis(&p->axis[i], &s->axis[i]);
            s->axis[i].strain_check = s->axis[i].stage_check = none;
        }
        s->axis[i].closed = 0;
    }
    enter(s, ARMED);
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
        if (state == TRACKING || (state == ARMED && s->phase == CLOSED))
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
        else if (state == ARMED || state == HOLDING)
            begin_ramp(p, s);
        else if (command == DISARM && state != READY)
            return false;
        return true;
    case RESET:
        if (state != FAULT || s->stopping)
            return false;
        forget(p, s);
        enter(s, READY);
        return true;
    default:
        return true;
    }
}

/* Where a polarity and scale check has ended: every answer inside what is expected, or a fault. */
static void judge_checks(const struct cell_parameters *p, struct cell_state *s, int phase)
{
    int64_t was = s->phase;

    if (s->state != ARMED || s->checked || phase == was || (was != PROBING && was != BUMPING))
        return;
    for (int i = 0; i < p->axes; i++) {
        const struct axis_parameters *axis = &p->axis[i];
        const struct axis_state *a = &s->axis[i];
        const struct check_parameters *limits = was == BUMPING ? &axis->stage_check : &axis->strain_check;
        double found = answer(was == BUMPING ? &a->stage_check : &a->strain_check, limits->step);
        bool good = limits->low <= found && found <= limits->high;
        double nearest = found > limits->high ? limits->high : limits->low;
        axis_fault(p, s, i, was == BUMPING ? STAGE_CHECK : STRAIN_CHECK, !good, found, nearest);
    }
    if (was == BUMPING && s->state == ARMED) {
        s->checked = 1;
        s->entered_cycle += 2 * p->check_cycles * p->axes;
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
    if (s->state == ARMED) {
        judge_checks(p, s, phase);
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
        bool finite = axis_cycle(axis, a, s->cycle, now_ns, tracks, own, fraction);
        axis_fault(p, s, i, NOT_FINITE, !finite, a->setpoint_um, NAN);
        outputs[axis->voltage] = a->voltage_V;
        if (s->state == TRACKING && s->cycle - s->tracking_cycle >= p->score_cycles)
            score(a, signals[axis->path_error].value, signals[axis->uncompensated].value);
        if (s->state == TRACKING)
            mean_squares(p, axis, a, s->cycle);
    }
    switch_outputs(p, s, outputs);
    return accepted;
}

#endif
