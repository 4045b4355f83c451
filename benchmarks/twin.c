/* One tracking cycle of the cell in plain C: the yardstick of `micromanip system bench`, and an oracle for the laws.
 *
 * Same records, same algorithms, same telemetry rows as micromanip/rt, for what config/paper.yaml does in each cycle:
 * stage control after a tracker, with a Prandtl-Ishlinskii model and tanh shaping. What is rare is told by numbers that
 * differ: a missed cycle, a sample that is refused, a demand that outruns the set-point, calm gains, a device that is
 * behind, the reaction to a fault. Lengths in um, voltages in V.
 */
#include <math.h>
#include <stdbool.h>
#include <time.h>

#include "records.h"
#define HISTORY_MASK (INPUT_HISTORY - 1)

/* Python's min and max: the first of two that do not compare. */
static inline double least(double a, double b) { return b < a ? b : a; }
static inline double most(double a, double b) { return b > a ? b : a; }
static inline int64_t earlier(int64_t a, int64_t b) { return a < b ? a : b; }
static inline int64_t later(int64_t a, int64_t b) { return a > b ? a : b; }

static void predict(const struct outer_parameters *p, double *restrict x, double u)
{
    double next[MAX_STATES];
    int padded = (int)(p->states + 3) / 4 * 4;    /* the padding is zero and stays zero */
    for (int i = 0; i < padded; i++)
        next[i] = p->b[i] * u;
    for (int first = 0; first < padded; first += ROWS_AT_ONCE) {
        int rows = padded - first < ROWS_AT_ONCE ? padded - first : ROWS_AT_ONCE;
        for (int j = 0; j < p->states; j++) {
            const double *a = p->a_blocks[first / ROWS_AT_ONCE][j];
            for (int i = 0; i < rows; i++)
                next[first + i] += a[i] * x[j];
        }
    }
    for (int i = 0; i < padded; i++)
        x[i] = next[i];
}

static double dot(const double *a, const double *b, int64_t count)
{
    double sum = 0.0;
    for (int i = 0; i < count; i++)
        sum += a[i] * b[i];
    return sum;
}

static void advance(const struct outer_parameters *p, const double *history, double *x, int64_t first, int64_t last)
{
    for (int64_t cycle = first; cycle < last; cycle++)
        predict(p, x, history[cycle & HISTORY_MASK]);
}

/* No more of an innovation than is plausible at once; while more comes the limit opens, and closes slowly again. */
static double believed(const struct outer_parameters *p, struct estimator_state *s, double innovation)
{
    double limit_um = s->repeated < 2 ? p->innovation_um + s->opened_um : p->repeated_um;
    double applied = most(-limit_um, least(limit_um, innovation));
    s->opened_um = most(2.0 * fabs(applied), 0.9 * s->opened_um);
    return applied;
}

static void update(const struct outer_parameters *p, struct estimator_state *s, int64_t sample_cycle, double y)
{
    int64_t now = s->cycle;
    int n = (int)p->states;
    int64_t passed = sample_cycle - s->filtered_cycle;
    if (sample_cycle <= s->filtered_cycle || sample_cycle > now || now - sample_cycle >= INPUT_HISTORY)
        return;
    s->repeated = y == s->reading_um ? s->repeated + 1 : 0;
    s->reading_um = y;
    if (sample_cycle == now)
        for (int i = 0; i < n; i++)
            s->filtered[i] = s->x[i];
    else
        advance(p, s->history, s->filtered, s->filtered_cycle, sample_cycle);
    s->innovation_um = y - dot(p->c, s->filtered, p->states);
    double applied = believed(p, s, s->innovation_um);
    const double *gain = p->gains[earlier(passed, GAPS) - 1];
    for (int i = 0; i < n; i++)
        s->x[i] = s->filtered[i] += gain[i] * applied;
    advance(p, s->history, s->x, sample_cycle, now);
    s->filtered_cycle = sample_cycle;
}


static bool read_signal(const struct signal *signal, struct sensor_state *s, int64_t now_ns, int64_t max_age_ns,
                        const double *range_um, double rate_um_per_ns)
{
    bool arrived = signal->sequence != s->sequence;
    double value = signal->value;
    bool good = signal->status == 0 && isfinite(value) && range_um[0] <= value && value <= range_um[1];
    s->fresh = 0;
    if (arrived) {
        int64_t taken_ns = earlier(signal->time_ns, now_ns);
        if (s->sequence > 0) {
            s->unseen += later(0, signal->sequence - s->sequence - 1);
            if (good && isfinite(rate_um_per_ns) && s->bad < BELIEVED)
                good = fabs(value - s->value) <= rate_um_per_ns * (double)later(now_ns - s->arrived_ns, taken_ns - s->taken_ns);
        }
        s->identical = value == s->reading ? s->identical + 1 : 0;
        s->sequence = signal->sequence;
        s->reading = value;
        s->arrived_ns = now_ns;
        s->taken_ns = taken_ns;
        if (good) {
            s->value = value;
            s->time_ns = taken_ns;
            s->fresh = 1;
            s->samples++;
        }
    }
    s->silent_ns = now_ns - s->taken_ns;
    s->age_ns = now_ns - s->time_ns;
    if ((arrived && !good) || s->sequence == 0 || s->age_ns > max_age_ns)
        s->bad++;
    else if (arrived)
        s->bad = 0;
    return s->fresh;
}

static inline bool is_silent(const struct sensor_state *s, int64_t ns) { return s->sequence == 0 || s->silent_ns > ns; }

/* Tracker: position, velocity, acceleration and oscillations, extrapolated in closed form. */
static void extrapolate(const struct reference_parameters *p, const double *restrict from, double tau_s,
                        double *restrict to)
{
    to[0] = from[0] + tau_s * (from[1] + 0.5 * tau_s * from[2]);
    to[1] = from[1] + tau_s * from[2];
    to[2] = from[2];
    for (int k = 0; k < p->modes; k++) {
        double omega = p->oscillator[k], left = p->decay[k] > 0.0 ? exp(-p->decay[k] * tau_s) : 1.0;
        double angle = omega * tau_s, sine = left * sin(angle), cosine = left * cos(angle);
        const double *o = from + 3 + 2 * k;
        to[3 + 2 * k] = cosine * o[0] + sine / omega * o[1];
        to[4 + 2 * k] = -omega * sine * o[0] + cosine * o[1];
    }
}

static double position(const double *w)
{
    double total = w[0];
    for (int k = 0; k < MAX_MODES; k++)
        total += w[3 + 2 * k];
    return total;
}

static bool foreseen(const struct reference_parameters *p, const struct reference_state *s, double gap_s)
{
    return gap_s <= p->horizon_s || (s->silent <= p->horizon_cycles && gap_s <= STOOD_STILL * p->horizon_s);
}

static void tracker_sample(const struct reference_parameters *p, struct reference_state *s, double value, int64_t time_ns)
{
    double gap_s = (double)(time_ns - s->time_ns) * 1e-9;
    if (!(isfinite(value) && p->low_um <= value && value <= p->high_um) || gap_s <= 0.0 || !foreseen(p, s, gap_s))
        return;
    extrapolate(p, s->filtered, gap_s, s->w);
    double innovation = value - position(s->w);
    if (fabs(innovation) > p->jump_um)
        return;
    s->silent = s->doubted = 0;
    for (int i = 0; i < REFERENCE_STATES; i++)
        s->filtered[i] = s->w[i] + p->gain[i] * innovation;
    s->sampled_um = value;
    s->time_ns = time_ns;
}

/* Inverse hysteresis: play operators, the inverse of c0 tanh(c1 v + c2) + c3. */
static double feedforward_voltage(const struct hysteresis_parameters *p, struct hysteresis_state *s, double setpoint_um)
{
    const double *c = p->shaping.c, open_interval = 1.0 - 1e-12;
    double y = most(p->low_um, least(p->high_um, setpoint_um)), u = y / p->alpha;
    for (int i = 0; i < p->plays; i++) {
        s->z[i] = most(y - p->r_hat[i], least(y + p->r_hat[i], s->z[i]));
        u += p->rho_hat[i] * s->z[i];
    }
    s->change_um = u - s->u_um;
    s->u_um = u;
    double ratio = most(-open_interval, least(open_interval, (u - c[3]) / c[0]));
    s->output_V = (atanh(ratio) - c[2]) / c[1];
    return s->output_V;
}

static void pid_step(const struct pid_parameters *p, struct pid_state *s, double error_um, int64_t periods)
{
    double elapsed_s = (double)periods * p->period_s;
    s->derivative = (p->filter_s * s->derivative + p->derivative * (error_um - s->error)) / (p->filter_s + elapsed_s);
    s->integrator += p->integral * (double)earlier(periods, p->most_periods) * error_um;
    s->error = error_um;
    s->output_V = p->K_V_per_um * error_um + s->integrator + s->derivative;
}

static double limit(const struct limiter_parameters *p, double previous_V, double requested_V)
{
    if (!isfinite(previous_V))
        return p->park_V;
    double target = isfinite(requested_V) ? requested_V : previous_V;
    target = most(previous_V - p->slew_V, least(previous_V + p->slew_V, target));
    return most(p->low_V, least(p->high_V, target));
}

/* Where what was wanted when a sample was taken stands: of its cycle, or of the nearest one that is remembered. */
static int64_t wanted_place(const struct axis_parameters *p, const struct axis_state *s, int64_t cycle, int64_t age_ns,
                            int64_t way)
{
    int64_t wanted = cycle - (int64_t)((double)age_ns * p->cycles_per_ns + 0.5) - way;
    return later(s->wanted_cycle - HISTORY_MASK, earlier(s->wanted_cycle, wanted)) & HISTORY_MASK;
}

/* The errors of a cycle: what the PID acts on, what is watched and what is scored. */
static void measure_errors(const struct axis_parameters *p, struct axis_state *s, int64_t cycle)
{
    s->strain_error_um = s->setpoints[wanted_place(p, s, cycle, s->strain.age_ns, p->answer_cycles)] - s->strain.value;
    s->path_um = s->references[wanted_place(p, s, cycle, s->stage.age_ns, 0)];
    s->stage_error_um = s->path_um - s->stage.value;
    s->error_fresh = s->strain.fresh;
}

static void measure(const struct axis_parameters *p, struct axis_state *s, const struct signal *signals, int64_t now_ns)
{
    s->reference.silent++;
    read_signal(&signals[p->strain], &s->strain, now_ns, p->strain_age_ns, p->strain_range_um, p->strain_rate_um_per_ns);
    read_signal(&signals[p->stage], &s->stage, now_ns, p->stage_age_ns, p->stage_range_um, p->stage_rate_um_per_ns);
    if (read_signal(&signals[p->deviation], &s->deviation, now_ns, p->reference_age_ns, (const double[]){-INFINITY, INFINITY}, INFINITY))
        tracker_sample(&p->reference, &s->reference, s->deviation.value, s->deviation.time_ns);
}

/* What is missing, and whether the PID makes a step. */
static void supervise(const struct axis_parameters *p, struct axis_state *s, const struct axis_order *order)
{
    struct supervisor_state *u = &s->supervisor;
    u->passed++;
    u->step = s->strain.fresh && !(order->reasons & GAUGE_LOST) ? u->passed : 0;
    int64_t late = u->step > 0 ? later(0, earlier(u->step - p->pid.most_periods, AT_ONCE)) : 0;
    if (order->reasons & GAUGE_LOST || u->step > 0)
        u->passed = 0;
    u->missing = (1.0 - 1.0 / REMEMBERED) * u->missing + (double)late;
    u->reasons = order->reasons | (u->missing > MANY ? MISSING : 0);
}

static double attainable(const struct axis_parameters *p, const struct axis_state *s, double demand_um)
{
    double low = least(p->setpoint_low_um, s->setpoint_um), high = most(p->setpoint_high_um, s->setpoint_um);
    return most(low, least(high, demand_um));
}

/* Whether the set-point is far behind a demand, as far as its range goes. */
static bool outruns(const struct axis_parameters *p, const struct axis_state *s, double demand_um)
{
    return fabs(attainable(p, s, demand_um) - s->setpoint_um) > BEHIND * p->setpoint_slew_um;
}

static double demand(const struct axis_parameters *p, struct axis_state *s, const struct axis_order *order)
{
    const struct outer_parameters *outer = &p->outer;
    double *w = s->reference.w, step = p->authority_step;
    s->blend.authority += most(-step, least(step, order->authority - s->blend.authority));
    for (int i = 0; i < REFERENCE_STATES; i++)
        w[i] *= s->blend.authority;
    double demand_um = p->centre_um + s->added_um + dot(outer->reference, w, outer->reference_states) -
                       dot(outer->feedback, s->estimator.x, outer->states);
    s->outer.bridge_um *= p->blend_decay;
    demand_um += s->outer.bridge_um;
    s->supervisor.nominal_cycles++;
    return outruns(p, s, demand_um) || s->supervisor.reasons & MISSING ? NAN : demand_um;
}

static bool move_setpoint(const struct axis_parameters *p, struct axis_state *s, double demand_um)
{
    double step = p->setpoint_slew_um;
    if (!isfinite(demand_um))
        return false;
    s->setpoint_um = most(s->setpoint_um - step, least(s->setpoint_um + step, attainable(p, s, demand_um)));
    return true;
}

static double request_voltage(const struct axis_parameters *p, struct axis_state *s)
{
    double feedforward = feedforward_voltage(&p->hysteresis, &s->hysteresis, s->setpoint_um);
    if (s->supervisor.step > 0)
        pid_step(s->supervisor.reasons & INNER_CALM ? &p->fallback : &p->pid, &s->pid, s->strain_error_um, s->supervisor.step);
    return feedforward + s->pid.output_V;
}

/* Whether every stage of the law is finite: estimate, feedforward, feedback and its memory, requested voltage. */
static bool is_finite(const struct axis_parameters *p, const struct axis_state *s)
{
    double total = s->request_V + s->hysteresis.u_um + s->hysteresis.output_V + s->pid.integrator + s->pid.derivative;
    for (int i = 0; i < p->outer.states; i++)
        total += s->estimator.x[i];
    return isfinite(total);
}

static bool axis_cycle(const struct axis_parameters *p, struct axis_state *s, const struct axis_order *order, int64_t cycle,
                       int64_t now_ns)
{
    supervise(p, s, order);
    advance(&p->outer, s->estimator.history, s->estimator.x, s->estimator.cycle, cycle);
    s->estimator.cycle = cycle;
    if (s->stage.fresh && !(s->supervisor.reasons & STAGE_LOST))
        update(&p->outer, &s->estimator, cycle - (int64_t)((double)s->stage.age_ns * p->cycles_per_ns + 0.5), s->stage.value);
    double age_s = (double)(now_ns - s->reference.time_ns) * 1e-9;
    if (p->reference.predict && s->reference.time_ns > 0 && foreseen(&p->reference, &s->reference, age_s))
        extrapolate(&p->reference, s->reference.filtered, age_s, s->reference.w);
    bool finite = move_setpoint(p, s, demand(p, s, order));
    s->setpoints[cycle & HISTORY_MASK] = s->setpoint_um;
    s->references[cycle & HISTORY_MASK] = position(s->reference.w);
    s->wanted_cycle = cycle;
    measure_errors(p, s, cycle);
    s->request_V = request_voltage(p, s);
    finite = finite && is_finite(p, s);
    s->voltage_V = limit(&p->limiter, s->voltage_V, s->request_V);
    s->pid.integrator -= p->pid.tracking * (s->request_V - s->voltage_V);
    s->pid.output_V -= p->pid.tracking * (s->request_V - s->voltage_V);
    s->estimator.history[s->estimator.cycle & HISTORY_MASK] = s->setpoint_um - p->centre_um - s->added_um;
    return finite;
}

/* What is watched: a word with a bit for each condition. Where a fault begins, the controller reacts and the twin does not. */
static inline int64_t lasting(int64_t count, bool active) { return active ? count + 1 : 0; }
static inline double square(double x) { return x * x; }
static inline int64_t condition(int64_t code, bool active) { return (int64_t)active << code; }

static double section_output(const struct section *p, struct section_state *s, double x)
{
    double y = p->b[0] * x + p->b[1] * s->x1 + p->b[2] * s->x2 - p->a[0] * s->y1 - p->a[1] * s->y2;
    s->x2 = s->x1;
    s->x1 = x;
    s->y2 = s->y1;
    s->y1 = y;
    return y;
}

static int64_t sensor_end(const struct sensor_state *sensor, const double *range_um)
{
    int64_t end = (sensor->reading >= range_um[1]) - (sensor->reading <= range_um[0]);
    bool pinned = sensor->bad >= 2 && sensor->identical && sensor->reading != sensor->value;
    return end || !pinned ? end : sensor->reading > sensor->value ? 1 : -1;
}

static bool swings(const struct watch_parameters *p, struct swing *w, int64_t cycle, int64_t end)
{
    if (end && w->end && end != w->end) {
        if (!w->times || cycle - w->first_cycle > p->swing_cycles) {
            w->times = 0;
            w->first_cycle = cycle;
        }
        w->times++;
    }
    w->end = end ? end : w->end;
    return w->times >= p->swings;
}

static int64_t watch_sensors(const struct axis_parameters *axis, const struct axis_state *a, struct watch_state *w)
{
    const struct watch_parameters *p = &axis->watch;
    bool bad = a->strain.bad >= p->strain_samples, stuck = a->strain.identical >= p->strain_identical;
    bool silent = is_silent(&a->strain, axis->strain_age_ns);
    w->coast = lasting(w->coast, bad || stuck);
    bool over = w->coast > p->coast_cycles;
    int64_t found = condition(COASTING, w->coast > 0) | condition(STRAIN_STUCK, over && stuck);
    found |= condition(STRAIN_SILENT, over && bad && silent) | condition(STRAIN_INVALID, over && bad && !silent);
    bad = a->stage.bad >= p->stage_samples;
    stuck = a->stage.identical >= p->stage_identical;
    w->degraded = lasting(w->degraded, bad || stuck);
    over = w->degraded > p->degraded_cycles;
    return found | condition(DEGRADED, w->degraded > 0) | condition(STAGE_INVALID, over && bad) |
           condition(STAGE_STUCK, over && stuck);
}

static int64_t watch_errors(const struct axis_parameters *axis, const struct axis_state *a, struct watch_state *w)
{
    const struct watch_parameters *p = &axis->watch;
    const struct limiter_parameters *limiter = &axis->limiter;
    bool known = w->degraded == 0 && w->coast == 0;
    if (a->stage.fresh && w->degraded == 0)
        w->innovation += p->innovation_step * (square(a->estimator.innovation_um) / p->innovation_variance - w->innovation);
    if (a->stage.fresh && known) {
        double apart_um = a->stage.value - p->drift_gain * (a->strain.value - axis->centre_um - a->added_um);
        if (p->drift_step * (double)w->settling < 1.0)
            w->apart_um += (apart_um - w->apart_um) / (double)++w->settling;
        else
            w->drift_um += p->drift_step * (apart_um - w->apart_um - w->drift_um);
    }
    w->following = lasting(w->following, known && fabs(a->stage_error_um) > p->following_um);
    w->saturated = lasting(w->saturated, a->request_V > limiter->high_V || a->request_V < limiter->low_V);
    return condition(DISAGREEMENT, w->innovation > p->innovation_ratio) |
           condition(STAGE_DRIFT, fabs(w->drift_um) > p->drift_um) |
           condition(FOLLOWING_ERROR, w->following >= p->following_cycles) |
           condition(SATURATING, w->saturated >= p->saturating_cycles) |
           condition(SATURATED, w->saturated >= p->saturated_cycles);
}

static int64_t watch_swings(const struct axis_parameters *axis, const struct axis_state *a, struct watch_state *w, int64_t cycle)
{
    const struct watch_parameters *p = &axis->watch;
    const struct limiter_parameters *limiter = &axis->limiter;
    if (a->error_fresh) {
        double error_um = section_output(&p->band_pass, &w->error_band, a->strain_error_um);
        double asked_um = section_output(&p->band_pass, &w->asked_band, a->setpoint_um);
        error_um = section_output(&p->tooth_notch, &w->error_notch, error_um);
        asked_um = section_output(&p->tooth_notch, &w->asked_notch, asked_um);
        w->band_energy += p->band_step * (square(error_um) - square(asked_um) - w->band_energy);
    }
    w->band_cycles = lasting(w->band_cycles, sqrt(fmax(0.0, w->band_energy)) > p->band_um);
    bool up = a->voltage_V >= limiter->high_V || a->setpoint_um >= axis->setpoint_high_um;
    bool down = a->voltage_V <= limiter->low_V || a->setpoint_um <= axis->setpoint_low_um;
    bool found = swings(p, &w->swing[0], cycle, up - down);
    found |= swings(p, &w->swing[1], cycle, sensor_end(&a->strain, axis->strain_range_um));
    found |= swings(p, &w->swing[2], cycle, sensor_end(&a->stage, axis->stage_range_um));
    return condition(FALLBACK, w->band_cycles >= p->band_cycles) | condition(OUTRUN, a->supervisor.calm_left > 0) |
           condition(LIMIT_CYCLE, found || a->supervisor.relapses >= p->swings);
}

static void watch_axis(const struct axis_parameters *axis, const struct axis_state *a, struct watch_state *w, int64_t cycle)
{
    const struct watch_parameters *p = &axis->watch;
    w->raised = watch_sensors(axis, a, w) | watch_errors(axis, a, w) | watch_swings(axis, a, w, cycle);
    w->raised |= condition(REFERENCE_STALE, a->reference.silent >= p->stale_cycles) |
                 condition(REFERENCE_STUCK, a->deviation.identical >= p->reference_identical) |
                 condition(REFERENCE_LOST, a->reference.silent >= p->lost_cycles);
}

static void score(struct figures *f, double error_um, double uncompensated_um)
{
    f->errors++;
    f->error_squares += square(error_um);
    f->error_max = most(f->error_max, fabs(error_um));
    f->uncompensated_squares += square(uncompensated_um);
}

/* The checks of arming count no more where a sensor was away. */
static void keep_checks(const struct cell_parameters *p, const struct axis_state *a, struct arming_state *arming)
{
    int64_t away_ns = BELIEVED * p->period_ns;
    arming->check[0].passed &= a->strain.bad < BELIEVED && !is_silent(&a->strain, away_ns);
    arming->check[1].passed &= arming->check[0].passed && !is_silent(&a->stage, away_ns);
}

static void give_order(const struct cell_parameters *p, struct cell_state *s, int i)
{
    const struct watch_state *w = &s->watch[i];
    s->order[i] = (struct axis_order){
        .phase = CLOSED, .level = 1.0, .held_share = 1.0, .followed = 1,
        .reasons = w->raised & FOUND,
        .held_since = s->order[i].held_since, .authority = p->axis[i].authority, .start_V = s->order[i].start_V,
        .time_s = (double)((s->cycle - s->tracking_cycle) * p->period_ns) * 1e-9, .part_begun = -1,
    };
}

static void cell_cycle(const struct cell_parameters *p, struct cell_state *s, const struct signal *signals, double *outputs,
                       int64_t now_ns)
{
    s->cycle++;
    for (int i = 0; i < p->axes; i++)
        measure(&p->axis[i], &s->axis[i], signals, now_ns);
    for (int i = 0; i < p->axes; i++)
        watch_axis(&p->axis[i], &s->axis[i], &s->watch[i], s->cycle);
    for (int i = 0; i < p->axes; i++)
        give_order(p, s, i);
    for (int i = 0; i < p->axes; i++) {
        const struct axis_parameters *axis = &p->axis[i];
        struct axis_state *a = &s->axis[i];
        s->watch[i].raised |= condition(NOT_FINITE, !axis_cycle(axis, a, &s->order[i], s->cycle, now_ns));
        outputs[axis->voltage] = a->voltage_V;
        struct figures *f = &s->figures[i];
        if (s->cycle - s->tracking_cycle >= p->score_cycles)
            score(f, signals[axis->path_error].value, signals[axis->uncompensated].value);
        f->error += p->figures_step * (square(a->stage_error_um) - f->error);
        f->innovation += p->figures_step * (square(a->estimator.innovation_um) - f->innovation);
        f->feedback += p->figures_step * (square(a->voltage_V - a->hysteresis.output_V) - f->feedback);
        keep_checks(p, a, &s->arming[i]);
    }
}

static void write_axis(const struct axis_parameters *p, const struct axis_state *a, int64_t raised,
                       const struct signal *signals, struct axis_row *row, int64_t now_ns)
{
    row->reference_um = position(a->reference.w);
    row->deviation_um = a->deviation.value;
    row->strain_um = a->strain.value;
    row->stage_um = a->stage.value;
    row->estimate_um = dot(p->outer.c, a->estimator.x, p->outer.states);
    row->innovation_um = a->estimator.innovation_um;
    row->setpoint_um = a->setpoint_um;
    row->feedforward_V = a->hysteresis.output_V;
    row->feedback_V = a->pid.output_V;
    row->voltage_V = a->voltage_V;
    row->true_strain_um = signals[p->true_strain].value;
    row->true_stage_um = signals[p->true_stage].value;
    row->path_error_um = signals[p->path_error].value;
    row->uncompensated_um = signals[p->uncompensated].value;
    row->tooth_Hz = row->joint_1_Hz = row->joint_2_Hz = row->joint_3_Hz = NAN;    /* it follows none of them, */
    row->notch_um = row->learned_um = 0.0;    /* has no notch and learns nothing */
    row->conditions = raised;
    row->strain_age_ns = (int32_t)earlier(a->strain.age_ns, INT64_C(2000000000));
    row->stage_age_ns = (int32_t)earlier(a->stage.age_ns, INT64_C(2000000000));
    row->deviation_age_ns = (int32_t)earlier(a->deviation.age_ns, INT64_C(2000000000));
    row->fresh = (int32_t)(a->strain.fresh + 2 * a->stage.fresh + 4 * a->deviation.fresh);
    row->fresh |= a->strain.arrived_ns == now_ns ? a->strain.identical > 0 ? 72 : 8 : 0;
    row->fresh |= a->stage.arrived_ns == now_ns ? a->stage.identical > 0 ? 144 : 16 : 0;
    row->fresh |= a->deviation.arrived_ns == now_ns ? 32 : 0;
}

static void write_row(const struct cell_parameters *p, const struct cell_state *s, const struct signal *signals,
                      struct row *row, int64_t now_ns)
{
    row->cycle = s->cycle;
    row->time_ns = now_ns;
    row->periods = 1;
    row->state = (int32_t)s->state;
    row->fault = (int32_t)s->fault;
    row->version = (int32_t)s->version;
    row->phase = (int32_t)s->phase;
    row->lines = 1 << 3;    /* the amplifiers are on; no digital input is wired */
    for (int i = 0; i < p->axes; i++)
        write_axis(&p->axis[i], &s->axis[i], s->watch[i].raised, signals, &row->axis[i], now_ns);
}

static int64_t clock_ns(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return now.tv_sec * INT64_C(1000000000) + now.tv_nsec;
}

/* Run `cycles` cycles on recorded signals, `repeats` times from the same state; a telemetry row each. Where words are to
 * be swept, as a neighbour on the core does, one of each cache line is written before each cycle, and that is timed. */
void replay(const struct cell_parameters *p, const struct cell_state *first, struct cell_state *s,
            const struct signal signals[][MAX_SIGNALS], double *outputs, struct row *rows,
            int64_t cycles, int64_t repeats, int64_t *swept, int64_t words, int64_t *taken_ns)
{
    for (int64_t r = 0; r < repeats; r++) {
        *s = *first;
        for (int64_t k = 0; k < cycles; k++) {
            for (int64_t j = 0; j < words; j += 8)
                swept[j]++;
            int64_t begun_ns = words > 0 ? clock_ns() : 0;
            int64_t now_ns = (s->cycle + 1) * p->period_ns;
            cell_cycle(p, s, signals[k], outputs, now_ns);
            write_row(p, s, signals[k], &rows[k], now_ns);
            if (words > 0)
                taken_ns[k] = clock_ns() - begun_ns;
        }
    }
}
