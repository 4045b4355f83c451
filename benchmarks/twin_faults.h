/* The fault manager in plain C: what is noticed is written down, latched and answered in the same cycle. */
#ifndef TWIN_FAULTS_H
#define TWIN_FAULTS_H

#include "twin_transitions.h"

static void note(struct cell_state *s, int64_t code, int64_t axis, double value, double limit, int64_t reaction)
{
    s->event[s->events % EVENTS] = (struct event){
        .cycle = s->cycle, .code = code, .axis = axis, .value = value, .limit = limit, .reaction = reaction, .state = s->state,
    };
    s->events++;
}

static bool begins(int64_t *raised, int64_t code, bool active)
{
    int64_t bit = INT64_C(1) << code;

    if (active == ((*raised & bit) != 0))
        return false;
    *raised ^= bit;
    return active;
}

static void react(const struct cell_parameters *p, struct cell_state *s, int64_t reaction)
{
    int64_t state = s->state;

    if (reaction == CUTS) {
        cut(p, s);
    } else if (state == READY || state == OFF) {
        enter(s, FAULT);
    } else if (reaction == HOLDS && state == HOLDING) {
        if (s->fault_cycle == s->cycle)
            enter(s, HOLDING);  /* one that was asked for: from now on its time is limited */
    } else if (reaction == HOLDS && (state == TRACKING || (state == ARMING && s->phase == CLOSED))) {
        begin_hold(p, s);
    } else if (state != FAULT) {
        begin_ramp(p, s);
    }
}

static void raise_fault(const struct cell_parameters *p, struct cell_state *s, int64_t code, int64_t axis, double value,
                        double limit, int64_t reaction)
{
    note(s, code, axis, value, limit, reaction);
    if (reaction == WARN)
        return;
    if (s->fault == NO_FAULT) {
        s->fault = code;
        s->fault_axis = axis;
        s->fault_value = value;
        s->fault_limit = limit;
        s->fault_cycle = s->cycle;
        s->trips++;
    }
    react(p, s, reaction);
}

static void warn(struct cell_state *s, int axis, int64_t code, bool active, double value, double limit)
{
    if (begins(&s->axis[axis].watch.raised, code, active))
        note(s, code, axis, value, limit, WARN);
}

static void axis_fault(const struct cell_parameters *p, struct cell_state *s, int axis, int64_t code, bool active,
                       double value, double limit)
{
    if (begins(&s->axis[axis].watch.raised, code, active))
        raise_fault(p, s, code, axis, value, limit, p->axis[axis].watch.reaction[code]);
}

static void cell_fault(const struct cell_parameters *p, struct cell_state *s, int64_t code, bool active, double value,
                       double limit)
{
    if (begins(&s->raised, code, active))
        raise_fault(p, s, code, -1, value, limit, p->reaction[code]);
}

static void forget(const struct cell_parameters *p, struct cell_state *s)
{
    s->fault = NO_FAULT;
    s->raised = 0;
    s->overruns_in_a_row = 0;
    s->overrun_level = 0.0;
    for (int i = 0; i < p->axes; i++) {
        s->axis[i].watch.raised = 0;
        s->axis[i].frozen = 0;
    }
}

#endif
