/* One telemetry row a cycle in plain C. */
#ifndef TWIN_TELEMETRY_H
#define TWIN_TELEMETRY_H

#include "twin_cell.h"

enum { OLDEST_NS = 2000000000 };

static void write_axis(const struct axis_parameters *p, const struct axis_state *a, const struct signal *signals,
                       struct axis_row *row)
{
    row->reference_um = a->reference.w[0] + a->reference.w[3];
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
    row->conditions = a->watch.raised;
    row->strain_age_ns = (int32_t)earlier(a->strain.age_ns, OLDEST_NS);
    row->stage_age_ns = (int32_t)earlier(a->stage.age_ns, OLDEST_NS);
    row->deviation_age_ns = (int32_t)earlier(a->deviation.age_ns, OLDEST_NS);
    row->fresh = (int32_t)(a->strain.fresh + 2 * a->stage.fresh + 4 * a->deviation.fresh);
}

static int32_t lines(const struct cell_parameters *p, const struct cell_state *s)
{
    return is_on(&p->enable, &s->enable) | is_on(&p->interlock, &s->interlock) << 1 |
           is_on(&p->retracted, &s->retracted) << 2 | is_moving(s) << 3 | asks_feed_hold(s) << 4;
}

static void write_row(const struct cell_parameters *p, const struct cell_state *s, const struct signal *signals,
                      struct row *row, int64_t now_ns, int64_t periods)
{
    row->cycle = s->cycle;
    row->time_ns = now_ns;
    row->lateness_ns = row->compute_ns = 0;
    row->periods = (int32_t)periods;
    row->state = (int32_t)s->state;
    row->fault = (int32_t)s->fault;
    row->version = (int32_t)s->version;
    row->phase = (int32_t)s->phase;
    row->lines = lines(p, s);
    for (int i = 0; i < p->axes; i++)
        write_axis(&p->axis[i], &s->axis[i], signals, &row->axis[i]);
}

#endif
