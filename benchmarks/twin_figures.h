/* Figures of merit in plain C: the path error of a run, and the mean squares by which tunings are compared. */
#ifndef TWIN_FIGURES_H
#define TWIN_FIGURES_H

#include "twin_watch.h"

static void score(struct axis_state *a, double error_um, double uncompensated_um)
{
    a->errors++;
    a->error_squares += error_um * error_um;
    a->error_max = most(a->error_max, fabs(error_um));
    a->uncompensated_squares += uncompensated_um * uncompensated_um;
}

static void mean_squares(const struct cell_parameters *p, struct axis_state *a)
{
    struct figures *f = &a->figures;
    double error_um = a->stage_error_um, innovation_um = a->estimator.innovation_um;
    double added_V = a->voltage_V - a->hysteresis.output_V;

    f->error += p->figures_step * (error_um * error_um - f->error);
    f->innovation += p->figures_step * (innovation_um * innovation_um - f->innovation);
    f->feedback += p->figures_step * (added_V * added_V - f->feedback);
}

#endif
