/* The cell's cycle in plain C, the yardstick of `micromanip bench`: same records, same algorithms, same rows. */
#include "twin_axis.h"

static double smooth(double x)
{
    x = most(0.0, least(1.0, x));
    return x * x * x * (10.0 + x * (6.0 * x - 15.0));
}

static void enter(struct cell_state *s, int64_t state)
{
    s->state = state;
    s->entered_cycle = s->cycle;
}

static void begin_ramp(const struct cell_parameters *p, struct cell_state *s, int64_t after)
{
    if (s->state == RAMPING) {
        if (after == OFF || s->after_ramp == READY)
            s->after_ramp = after;
        return;
    }
    for (int i = 0; i < p->axes; i++)
        s->axis[i].start_V = s->axis[i].voltage_V;
    s->after_ramp = after;
    enter(s, RAMPING);
}

static void raise_fault(const struct cell_parameters *p, struct cell_state *s, int64_t fault, int axis, double value)
{
    if (s->fault == NO_FAULT) {
        s->fault = fault;
        s->fault_axis = axis;
        s->fault_value = value;
        s->fault_cycle = s->cycle;
    }
    if (s->state == READY || s->state == OFF)
        enter(s, FAULT);
    else if (s->state != FAULT)
        begin_ramp(p, s, FAULT);
}

static int64_t sensor_fault(const struct axis_state *a, int64_t bad_samples, bool closed)
{
    if (a->strain.bad >= bad_samples)
        return STRAIN_INVALID;
    return closed && a->stage.bad >= bad_samples ? STAGE_INVALID : NO_FAULT;
}

static bool apply_command(const struct cell_parameters *p, struct cell_state *s, int64_t command)
{
    switch (command) {
    case ARM:
        if (s->state != READY)
            return false;
        for (int i = 0; i < p->axes; i++)
            if (sensor_fault(&s->axis[i], 1, false) != NO_FAULT)
                return false;
        for (int i = 0; i < p->axes; i++)
            start_axis(&p->axis[i], &s->axis[i]);
        enter(s, ARMED);
        break;
    case DISARM:
        if (s->state == ARMED || s->state == TRACKING)
            begin_ramp(p, s, READY);
        else if (s->state != READY)
            return false;
        break;
    case STOP:
        if (s->state == READY || s->state == FAULT)
            enter(s, OFF);
        else if (s->state != OFF)
            begin_ramp(p, s, OFF);
        break;
    case RESET:
        if (s->state != FAULT)
            return false;
        s->fault = NO_FAULT;
        enter(s, READY);
        break;
    }
    return true;
}

static bool is_parked(const struct cell_parameters *p, const struct cell_state *s)
{
    for (int i = 0; i < p->axes; i++)
        if (fabs(s->axis[i].voltage_V - p->axis[i].limiter.park_V) > p->axis[i].limiter.slew_V)
            return false;
    return true;
}

static void finish_phase(const struct cell_parameters *p, struct cell_state *s)
{
    int64_t passed = s->cycle - s->entered_cycle;

    if (s->state == ARMED && passed >= p->lift_cycles + p->settle_cycles + p->authority_cycles) {
        s->tracking_cycle = s->cycle;
        enter(s, TRACKING);
    } else if (s->state == RAMPING && passed >= p->ramp_cycles && is_parked(p, s)) {
        enter(s, s->after_ramp);
    }
}

static int phase_of(const struct cell_parameters *p, const struct cell_state *s, double *fraction)
{
    double passed = (double)(s->cycle - s->entered_cycle);
    int64_t lift = p->lift_cycles, lifted = lift + p->settle_cycles;

    switch (s->state) {
    case ARMED:
        *fraction = passed < lifted ? smooth(passed / lift) : smooth((passed - lifted) / p->authority_cycles);
        return passed < lifted ? LIFTING : CLOSED;
    case TRACKING:
        *fraction = 1.0;
        return CLOSED;
    case RAMPING:
        *fraction = smooth(passed / p->ramp_cycles);
        return PARKING;
    default:
        *fraction = 0.0;
        return PARKED;
    }
}

static void cell_cycle(const struct cell_parameters *p, struct cell_state *s, const struct signal *signals, double *outputs,
                       int64_t command, int64_t now_ns, int64_t periods)
{
    double fraction;

    s->cycle += periods;    /* arming and a ramp wait while the loop is late */
    if (s->state == ARMED || s->state == RAMPING)
        s->entered_cycle += periods - 1;
    bool closed = phase_of(p, s, &fraction) == CLOSED;
    for (int i = 0; i < p->axes; i++) {
        sample(&p->axis[i], &s->axis[i], signals, now_ns);
        int64_t fault = sensor_fault(&s->axis[i], p->bad_samples, closed);
        if (fault != NO_FAULT && (s->state == ARMED || s->state == TRACKING))
            raise_fault(p, s, fault, i, (double)p->bad_samples);
    }
    if (command != NO_COMMAND)
        apply_command(p, s, command);
    finish_phase(p, s);
    int phase = phase_of(p, s, &fraction);
    bool scored = s->state == TRACKING && s->cycle - s->tracking_cycle >= p->score_cycles;
    for (int i = 0; i < p->axes; i++) {
        struct axis_state *a = &s->axis[i];
        if (!axis_cycle(&p->axis[i], a, s->cycle, now_ns, phase, fraction))
            raise_fault(p, s, NOT_FINITE, i, a->setpoint_um);
        outputs[p->axis[i].voltage] = a->voltage_V;
        if (scored) {
            double error = signals[p->axis[i].path_error].value, uncompensated = signals[p->axis[i].uncompensated].value;
            a->errors++;
            a->error_squares += error * error;
            a->error_max = most(a->error_max, fabs(error));
            a->uncompensated_squares += uncompensated * uncompensated;
        }
    }
}

static void axis_row(const struct axis_parameters *p, const struct axis_state *a, const struct signal *signals,
                     struct axis_row *row)
{
    row->reference_um = a->reference.w[0];
    row->deviation_um = a->deviation.value;
    row->strain_um = a->strain.value;
    row->stage_um = a->stage.value;
    row->estimate_um = output(&p->outer, a->estimator.x);
    row->innovation_um = a->estimator.innovation_um;
    row->setpoint_um = a->setpoint_um;
    row->feedforward_V = a->hysteresis.output_V;
    row->feedback_V = a->pid.output_V;
    row->voltage_V = a->voltage_V;
    row->true_strain_um = signals[p->true_strain].value;
    row->true_stage_um = signals[p->true_stage].value;
    row->path_error_um = signals[p->path_error].value;
    row->uncompensated_um = signals[p->uncompensated].value;
    row->strain_age_ns = (int32_t)earlier(a->strain.age_ns, 2000000000);
    row->stage_age_ns = (int32_t)earlier(a->stage.age_ns, 2000000000);
    row->deviation_age_ns = (int32_t)earlier(a->deviation.age_ns, 2000000000);
    row->fresh = (int32_t)(a->strain.fresh + 2 * a->stage.fresh + 4 * a->deviation.fresh);
}

/* Run `cycles` cycles on recorded signals, `repeats` times from the same state; a telemetry row each. */
void replay(const struct cell_parameters *p, const struct cell_state *first, struct cell_state *s,
            const struct signal signals[][MAX_SIGNALS], const int64_t *commands, const int64_t *periods, double *outputs,
            struct row *rows, int64_t cycles, int64_t repeats)
{
    for (int64_t r = 0; r < repeats; r++) {
        *s = *first;
        for (int64_t k = 0; k < cycles; k++) {
            int64_t now_ns = (s->cycle + periods[k]) * p->period_ns;
            cell_cycle(p, s, signals[k], outputs, commands[k], now_ns, periods[k]);
            struct row *row = &rows[k];
            row->cycle = s->cycle;
            row->time_ns = now_ns;
            row->lateness_ns = row->compute_ns = 0;
            row->periods = (int32_t)periods[k];
            row->state = (int32_t)s->state;
            row->fault = (int32_t)s->fault;
            row->version = (int32_t)s->version;
            for (int i = 0; i < p->axes; i++)
                axis_row(&p->axis[i], &s->axis[i], signals[k], &row->axis[i]);
        }
    }
}
