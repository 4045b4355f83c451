/* The sequence of arming in plain C: what refuses it, its phases, the polarity check's step, the decaying sweep. */
#ifndef TWIN_ARMING_H
#define TWIN_ARMING_H

#include "twin_axis.h"

#define TWO_PI 6.283185307179586

static double smooth(double x)
{
    x = most(0.0, least(1.0, x));
    return x * x * x * (10.0 + x * (6.0 * x - 15.0));
}

/* The fault that the capacitive sensor would be to arming: at an end of its range it is none, unless it must be usable. */
static int64_t stage_loss(const struct axis_parameters *p, const struct axis_state *s, int64_t samples, bool usable)
{
    const struct sensor_state *sensor = &s->stage;
    bool excused = !usable && may_be_at_end(sensor, p->stage_range_um);

    if (is_silent(sensor, p->stage_age_ns + (int64_t)((double)samples / p->cycles_per_ns)) ||
        (sensor->bad >= samples && !excused))
        return STAGE_INVALID;
    return sensor->identical >= p->watch.stage_identical && !excused ? STAGE_STUCK : NO_FAULT;
}

static int64_t refuse_axis(const struct axis_parameters *p, const struct axis_state *s, bool resuming)
{
    const struct watch_parameters *limits = &p->watch;
    int64_t reasons = 0;

    if (s->strain.bad > 0 || s->strain.identical >= limits->strain_identical)
        reasons |= STRAIN_MISSING;
    if (stage_loss(p, s, 1, resuming) != NO_FAULT)
        reasons |= STAGE_MISSING;
    if (p->reference.kind == SIGNAL && (s->reference.time_ns == 0 || s->reference.silent >= limits->stale_cycles))
        reasons |= REFERENCE_MISSING;
    if (is_missing(&p->amplifier_ok, &s->amplifier_ok))
        reasons |= AMPLIFIER_MISSING;
    if (is_missing(&p->temperature_ok, &s->temperature_ok))
        reasons |= TEMPERATURE_MISSING;
    if (resuming && s->frozen)
        reasons |= NOT_RESUMABLE;
    return reasons;
}

static bool refuse(const struct cell_parameters *p, struct cell_state *s)
{
    bool resuming = s->state == HOLDING, refused;

    s->refused = 0;
    if (s->state != READY && !resuming)
        s->refused |= NOT_READY;
    if (s->fault != NO_FAULT || s->stopping)
        s->refused |= LATCHED;
    if (is_missing(&p->enable, &s->enable))
        s->refused |= ENABLE_MISSING;
    if (is_missing(&p->interlock, &s->interlock))
        s->refused |= INTERLOCK_MISSING;
    if (s->link_down)
        s->refused |= LINK_MISSING;
    if (s->outputs_taken)
        s->refused |= OUTPUTS_MISSING;
    refused = s->refused != 0;
    for (int i = 0; i < p->axes; i++) {
        s->axis[i].refused = refuse_axis(&p->axis[i], &s->axis[i], resuming);
        refused |= s->axis[i].refused != 0;
    }
    return refused;
}

static void start_check(struct check_state *c)
{
    c->before = c->after = 0.0;
    c->before_samples = c->after_samples = c->turn = 0;
}

/* Each loop whose check does not count (any more) has its turn in this arming. */
static void plan_checks(const struct cell_parameters *p, struct cell_state *s)
{
    s->probes = s->bumps = 0;
    for (int i = 0; i < p->axes; i++) {
        struct axis_state *a = &s->axis[i];
        start_check(&a->strain_check);
        start_check(&a->stage_check);
        if (p->check_cycles > 0 && !a->strain_check.passed)
            a->strain_check.turn = ++s->probes;
        if (p->check_cycles > 0 && !a->stage_check.passed)
            a->stage_check.turn = ++s->bumps;
    }
}

static int64_t arming_cycles(const struct cell_parameters *p, const struct cell_state *s)
{
    if (s->resumed)
        return p->authority_cycles;
    return p->enable_cycles + p->check_cycles * (s->probes + s->bumps) + p->lift_cycles + p->sweep_cycles +
           p->settle_cycles + p->authority_cycles;
}

static int arming_phase(const struct cell_parameters *p, const struct cell_state *s, double passed, double *fraction)
{
    const struct {
        int phase;
        int64_t cycles;
    } sequence[] = {
        {PARKED, p->enable_cycles},
        {CHECKING_GAUGE, p->check_cycles * s->probes},
        {LIFTING, p->lift_cycles},
        {CHECKING_STAGE, p->check_cycles * s->bumps},
        {SWEEPING, p->sweep_cycles},
        {LIFTING, p->settle_cycles},
    };
    const int lift = 2, settle = 5, phases = 6;

    for (int k = 0; k < phases && !s->resumed; k++) {
        double length = (double)sequence[k].cycles;
        if (passed < length) {
            *fraction = k == 0 ? 0.0 : k == lift ? smooth(passed / length) : k == settle ? 1.0 : passed / length;
            return sequence[k].phase;
        }
        passed -= length;
    }
    *fraction = smooth(passed / (double)p->authority_cycles);
    return CLOSED;
}

/* One axis' step (0..1) for `place` 0..1: rest, up, rest, down, a quarter each. */
static double check_step(double place) { return smooth(4.0 * place - 1.0) - smooth(4.0 * place - 3.0); }

static void gather(struct check_state *c, double place, double value)
{
    if (0.125 <= place && place < 0.25) {
        c->before += value;
        c->before_samples++;
    } else if (0.625 <= place && place < 0.75) {
        c->after += value;
        c->after_samples++;
    }
}

static double answer(const struct check_state *c, double step)
{
    if (c->before_samples == 0 || c->after_samples == 0)
        return NAN;
    return (c->after / (double)c->after_samples - c->before / (double)c->before_samples) / step;
}

static double sweep_offset(const struct cell_parameters *p, const struct axis_parameters *axis, double fraction)
{
    double room = least(axis->centre_um - axis->setpoint_low_um, axis->setpoint_high_um - axis->centre_um);
    double amplitude = most(0.0, least(axis->sweep_um, room)), turns = p->sweep_turns * fraction;

    return amplitude * smooth(2.0 * turns) * (1.0 - fraction) * sin(TWO_PI * turns);
}

/* Offsets of the axes in a check or a sweep; the fraction that the axes get. */
static double arming_step(const struct cell_parameters *p, struct cell_state *s, int phase, double fraction)
{
    bool checking = phase == CHECKING_GAUGE || phase == CHECKING_STAGE;
    int64_t turns = phase == CHECKING_GAUGE ? s->probes : s->bumps;
    volatile double place = checking ? fraction * (double)turns : 0.0;  /* rounded: not fused with what follows */
    int turn = (int)place;

    for (int i = 0; i < p->axes; i++) {
        const struct axis_parameters *axis = &p->axis[i];
        struct axis_state *a = &s->axis[i];
        if (phase == LIFTING && (s->phase == PARKED || s->phase == CHECKING_GAUGE))
            start_axis(axis, a);
        a->offset = phase == SWEEPING ? sweep_offset(p, axis, fraction) : 0.0;
        const struct check_parameters *limits = phase == CHECKING_GAUGE ? &axis->strain_check : &axis->stage_check;
        struct check_state *c = phase == CHECKING_GAUGE ? &a->strain_check : &a->stage_check;
        if (!checking || c->turn != turn + 1)
            continue;
        a->offset = limits->step * check_step(place - turn);
        gather(c, place - turn, phase == CHECKING_GAUGE ? a->strain.value : a->stage.value);
    }
    return checking || phase == SWEEPING ? 1.0 : fraction;
}

#endif
