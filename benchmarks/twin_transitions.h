/* The cell's states and their changes in plain C; what the axes do in each. */
#ifndef TWIN_TRANSITIONS_H
#define TWIN_TRANSITIONS_H

#include "twin_arming.h"

static void enter(struct cell_state *s, int64_t state)
{
    s->state = state;
    s->entered_cycle = s->cycle;
}

static void begin_hold(const struct cell_parameters *p, struct cell_state *s)
{
    for (int i = 0; i < p->axes; i++)
        s->axis[i].closed = 0;
    enter(s, HOLDING);
}

static void begin_soft_stop(const struct cell_parameters *p, struct cell_state *s)
{
    for (int i = 0; i < p->axes; i++) {
        s->axis[i].hold_um = 0.0;
        s->axis[i].hold_scale = 1.0;
    }
    s->soft = 1;
    enter(s, RAMPING);
}

static void begin_ramp(const struct cell_parameters *p, struct cell_state *s)
{
    if (s->state == RAMPING && !s->soft)
        return;
    for (int i = 0; i < p->axes; i++)
        s->axis[i].start_V = s->axis[i].voltage_V;
    s->soft = 0;
    enter(s, RAMPING);
}

static void cut(const struct cell_parameters *p, struct cell_state *s)
{
    for (int i = 0; i < p->axes; i++) {
        s->axis[i].closed = 0;
        s->axis[i].estimator.running = 0;
    }
    if (s->state != OFF)
        enter(s, FAULT);
}

static bool is_parked(const struct cell_parameters *p, const struct cell_state *s)
{
    for (int i = 0; i < p->axes; i++) {
        const struct limiter_parameters *limiter = &p->axis[i].limiter;
        if (fabs(s->axis[i].voltage_V - limiter->park_V) > limiter->slew_V)
            return false;
    }
    return true;
}

static void finish_phase(const struct cell_parameters *p, struct cell_state *s, bool retracted)
{
    int64_t passed = s->cycle - s->entered_cycle;
    bool waits_for_nobody = s->fault != NO_FAULT || s->stopping;

    if (s->state == ARMING && passed >= arming_cycles(p, s)) {
        s->tracking_cycle = s->cycle;
        enter(s, TRACKING);
    } else if ((s->state == HOLDING && waits_for_nobody && (retracted || passed >= p->hold_cycles)) ||
               (s->state == RAMPING && s->soft && passed >= p->authority_cycles)) {
        begin_ramp(p, s);
    } else if (s->state == RAMPING && !s->soft && passed >= p->ramp_cycles && is_parked(p, s)) {
        enter(s, s->fault != NO_FAULT ? FAULT : READY);
    }
    if (s->stopping && (s->state == READY || s->state == FAULT) && is_parked(p, s))
        enter(s, OFF);
}

static int phase_of(const struct cell_parameters *p, const struct cell_state *s, double *fraction)
{
    double passed = (double)(s->cycle - s->entered_cycle);

    switch (s->state) {
    case ARMING:
        return arming_phase(p, s, passed, fraction);
    case TRACKING:
        *fraction = 1.0;
        return CLOSED;
    case HOLDING:
        *fraction = 0.0;
        return CLOSED;
    case RAMPING:
        if (s->soft) {
            *fraction = 1.0 - smooth(passed / (double)p->authority_cycles);
            return CLOSED;
        }
        *fraction = smooth(passed / (double)p->ramp_cycles);
        return PARKING;
    default:
        *fraction = 0.0;
        return PARKED;
    }
}

/* Arming and a ramp wait where they are while the loop is late. */
static void pass_missed(struct cell_state *s, int64_t missed)
{
    s->cycle += missed;
    if (s->state == ARMING || s->state == RAMPING)
        s->entered_cycle += missed;
}

#endif
