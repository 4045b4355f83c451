/* An analogue card with one output, wired back to its one input. */
#include <stdint.h>

struct signal { double value; int64_t time_ns; int64_t sequence; int64_t status; };
struct card { double um_per_V; double output_V; int64_t is_open; };

int32_t card_open(void *context)
{
    ((struct card *)context)->is_open = 1; /* here a real driver opens its device: this may block */
    return 0;
}

int32_t card_exchange(void *context, const double *outputs, struct signal *inputs, int64_t now_ns, int64_t periods)
{
    struct card *card = context;
    (void)periods;
    if (!card->is_open)
        return 7; /* a code of ours; the loop reports it as fault X-103 and ramps down */
    inputs[0].value = card->um_per_V * card->output_V; /* read first ... */
    inputs[0].time_ns = now_ns;
    inputs[0].status = 0;
    inputs[0].sequence++;
    card->output_V = outputs[0]; /* ... then write: both at the same instant of every period */
    return 0;
}

int32_t card_safe(void *context)
{
    ((struct card *)context)->output_V = 0.0;
    return 0;
}

int32_t card_close(void *context)
{
    ((struct card *)context)->is_open = 0;
    return 0;
}
