/* Co-simulation around the header: inputs tau, parameters q_start and v_start, outputs q and v.
   Value references: 1.. tau, then q_start, v_start, q, v of the joints in their order. */
#include <stdlib.h>
#include <string.h>

#include "NAME.h"

#define DOF NAME_DOF
#define EXPORTED

typedef struct {
    REAL tau[DOF], q_start[DOF], v_start[DOF];
    NAME_state state;
    double time;
    int started;
} Instance;

static const REAL default_start[DOF] = {START};

static void *make(void)
{
    Instance *m = (Instance *)calloc(1, sizeof(Instance));
    if (m)
        for (int i = 0; i < DOF; i++) m->q_start[i] = default_start[i];
    return m;
}

static int begin(Instance *m)
{
    m->started = NAME_start(&m->state, m->q_start, m->v_start);
    return m->started ? 0 : 3;
}

static int get(Instance *m, const unsigned int vr[], size_t n, double value[])
{
    if (!m->started && begin(m)) return 3;
    for (size_t k = 0; k < n; k++) {
        const unsigned int i = vr[k];
        if (i == 0) value[k] = m->time;
        else if (i <= DOF) value[k] = (double)m->tau[i - 1];
        else if (i <= 2 * DOF) value[k] = (double)m->q_start[i - DOF - 1];
        else if (i <= 3 * DOF) value[k] = (double)m->v_start[i - 2 * DOF - 1];
        else if (i <= 4 * DOF) value[k] = (double)m->state.q[i - 3 * DOF - 1];
        else if (i <= 5 * DOF) value[k] = (double)m->state.v[i - 4 * DOF - 1];
        else return 3;
    }
    return 0;
}

static int set(Instance *m, const unsigned int vr[], size_t n, const double value[])
{
    for (size_t k = 0; k < n; k++) {
        const unsigned int i = vr[k];
        if (i >= 1 && i <= DOF) m->tau[i - 1] = (REAL)value[k];
        else if (i > DOF && i <= 2 * DOF) m->q_start[i - DOF - 1] = (REAL)value[k], m->started = 0;
        else if (i > 2 * DOF && i <= 3 * DOF) m->v_start[i - 2 * DOF - 1] = (REAL)value[k], m->started = 0;
        else return 3;
    }
    return 0;
}

static int move(Instance *m, double now, double step)
{
    if (!m->started && begin(m)) return 3;
    if (step > 0 && !NAME_step(&m->state, m->tau, (REAL)step)) return 3;
    m->time = now + step;
    return 0;
}

static void reset(Instance *m)
{
    memset(m, 0, sizeof(*m));
    for (int i = 0; i < DOF; i++) m->q_start[i] = default_start[i];
}

VERSION_PART
