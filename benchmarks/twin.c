/* The cell's cycle in plain C, the yardstick of `micromanip bench`: same records, same algorithms, same rows.
 *
 *   twin_sensor  twin_laws  twin_estimator      one signal, one law
 *   twin_axis    twin_arming                    one axis; what arming makes of it
 *   twin_transitions  twin_faults  twin_watch   states, reactions, what is watched
 *   twin_cell    twin_figures  twin_telemetry   the cycle, its figures of merit, its row
 */
#include "twin_telemetry.h"

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
            write_row(p, s, signals[k], &rows[k], now_ns, periods[k]);
        }
    }
}
