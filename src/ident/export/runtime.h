/* --- motion: forces to movement ------------------------------------------------------------- */

/* The state of a simulation. mode: -1 and 1 slide, 0 is stuck. */
typedef struct {
    REAL q[NAME_DOF]; /* coordinates of the independent joints, as they are logged */
    REAL v[NAME_DOF];
    REAL tree[NAME_JOINTS]; /* true coordinates of all joints; the first guess of the next step */
    int mode[NAME_DOF];
} NAME_state;

/* Solve A x = b for k right sides by elimination with pivots; 0 where A is singular. */
static int NAME_solve(int n, int k, REAL *a, REAL *b)
{
    for (int i = 0; i < n; i++) {
        int p = i;
        for (int r = i + 1; r < n; r++)
            if (NAME_abs(a[r + n * i]) > NAME_abs(a[p + n * i])) p = r;
        if (!(NAME_abs(a[p + n * i]) > NAME_TINY)) return 0;
        if (p != i) {
            for (int c = 0; c < n; c++) {
                const REAL t = a[i + n * c];
                a[i + n * c] = a[p + n * c];
                a[p + n * c] = t;
            }
            for (int c = 0; c < k; c++) {
                const REAL t = b[i + n * c];
                b[i + n * c] = b[p + n * c];
                b[p + n * c] = t;
            }
        }
        for (int r = i + 1; r < n; r++) {
            const REAL f = a[r + n * i] / a[i + n * i];
            for (int c = i; c < n; c++) a[r + n * c] -= f * a[i + n * c];
            for (int c = 0; c < k; c++) b[r + n * c] -= f * b[i + n * c];
        }
    }
    for (int c = 0; c < k; c++)
        for (int i = n - 1; i >= 0; i--) {
            REAL s = b[i + n * c];
            for (int j = i + 1; j < n; j++) s -= a[i + n * j] * b[j + n * c];
            b[i + n * c] = s / a[i + n * i];
        }
    return 1;
}

/* M (dof, dof), h (dof) without dry friction, F (dof) its largest size; 0 at a singular position. */
static int NAME_terms(const REAL q[], const REAL v[], REAL tree[], REAL M[], REAL h[], REAL F[])
{
    REAL rates[NAME_JOINTS], Z[NAME_JOINTS * NAME_DOF], drift[NAME_JOINTS];
    REAL full[NAME_JOINTS * NAME_JOINTS], bias[NAME_JOINTS], limit[NAME_JOINTS];
    if (!NAME_tree(q, v, tree, rates, Z, drift)) return 0;
    NAME_mass_matrix_tree(tree, full);
    NAME_bias_tree(tree, rates, bias);
    NAME_dry_friction_tree(rates, limit);
    for (int j = 0; j < NAME_JOINTS; j++) {
        /* dry friction of joints that depend on others is smooth */
        if (!NAME_is_independent[j]) bias[j] += limit[j] * NAME_tanh(rates[j] / NAME_SMOOTH);
        for (int i = 0; i < NAME_JOINTS; i++) bias[j] += full[j + NAME_JOINTS * i] * drift[i];
    }
    for (int a = 0; a < NAME_DOF; a++) {
        h[a] = 0;
        F[a] = limit[NAME_independent[a]];
        for (int i = 0; i < NAME_JOINTS; i++) h[a] += Z[i + NAME_JOINTS * a] * bias[i];
        for (int b = 0; b < NAME_DOF; b++) {
            REAL s = 0;
            for (int i = 0; i < NAME_JOINTS; i++)
                for (int j = 0; j < NAME_JOINTS; j++)
                    s += Z[i + NAME_JOINTS * a] * full[i + NAME_JOINTS * j] * Z[j + NAME_JOINTS * b];
            M[a + NAME_DOF * b] = s;
        }
    }
    return 1;
}

/* Accelerations in the modes; f: friction that holds the joints that are stuck; 0: singular. */
static int NAME_acceleration(const REAL q[], const REAL v[], const REAL tau[], const int mode[],
                             REAL tree[], REAL acc[], REAL f[], REAL F[])
{
    REAL M[NAME_DOF * NAME_DOF], A[NAME_DOF * NAME_DOF], h[NAME_DOF], b[NAME_DOF];
    int at[NAME_DOF], n = 0;
    if (!NAME_terms(q, v, tree, M, h, F)) return 0;
    for (int i = 0; i < NAME_DOF; i++) {
        acc[i] = 0;
        f[i] = NAME_gain[i] * tau[i] - h[i];
        if (mode[i] != 0 || !(F[i] > 0)) at[n++] = i;
    }
    for (int c = 0; c < n; c++) {
        b[c] = f[at[c]] - (REAL)mode[at[c]] * F[at[c]];
        for (int r = 0; r < n; r++) A[r + n * c] = M[at[r] + NAME_DOF * at[c]];
    }
    if (!NAME_solve(n, 1, A, b)) return 0;
    for (int c = 0; c < n; c++) acc[at[c]] = b[c];
    for (int i = 0; i < NAME_DOF; i++)
        for (int c = 0; c < n; c++) f[i] -= M[i + NAME_DOF * at[c]] * b[c];
    return 1;
}

/* One step of the classical Runge-Kutta method within the present modes. */
static int NAME_runge_kutta(const NAME_state *s, const REAL tau[], REAL dt, NAME_state *out)
{
    REAL kq[4][NAME_DOF], kv[4][NAME_DOF], f[NAME_DOF], F[NAME_DOF];
    const REAL share[4] = {0, HALF, HALF, 1};
    *out = *s;
    for (int k = 0; k < 4; k++) {
        REAL q[NAME_DOF], v[NAME_DOF];
        for (int i = 0; i < NAME_DOF; i++) {
            const REAL h = k ? share[k] * dt : 0;
            q[i] = s->q[i] + (k ? h * kq[k - 1][i] : 0);
            v[i] = s->v[i] + (k ? h * kv[k - 1][i] : 0);
            kq[k][i] = v[i];
        }
        if (!NAME_acceleration(q, v, tau, s->mode, out->tree, kv[k], f, F)) return 0;
    }
    for (int i = 0; i < NAME_DOF; i++) {
        out->q[i] = s->q[i] + dt / 6 * (kq[0][i] + 2 * kq[1][i] + 2 * kq[2][i] + kq[3][i]);
        out->v[i] = s->v[i] + dt / 6 * (kv[0][i] + 2 * kv[1][i] + 2 * kv[2][i] + kv[3][i]);
    }
    return 1;
}

/* Whether a joint has stopped within a step, or friction no longer holds one that is stuck. */
static int NAME_event(const NAME_state *s, const NAME_state *next, const REAL tau[])
{
    REAL acc[NAME_DOF], f[NAME_DOF], F[NAME_DOF], tree[NAME_JOINTS];
    int stuck = 0;
    for (int i = 0; i < NAME_DOF; i++) {
        if (s->mode[i] != 0 && next->v[i] * (REAL)s->mode[i] < 0) return 1;
        stuck |= s->mode[i] == 0 && NAME_has_friction[i];
    }
    if (!stuck) return 0;
    for (int j = 0; j < NAME_JOINTS; j++) tree[j] = next->tree[j];
    if (!NAME_acceleration(next->q, next->v, tau, s->mode, tree, acc, f, F)) return 0;
    for (int i = 0; i < NAME_DOF; i++)
        if (s->mode[i] == 0 && F[i] > 0 && NAME_abs(f[i]) > F[i]) return 1;
    return 0;
}

/* Let joints at rest stick if friction can hold them, else slide the way they are pushed. */
static int NAME_decide(NAME_state *s, const REAL tau[], const int resting[])
{
    REAL acc[NAME_DOF], f[NAME_DOF], F[NAME_DOF];
    for (int i = 0; i < NAME_DOF; i++)
        if (resting[i]) s->mode[i] = 0;
    for (int k = 0; k <= NAME_DOF; k++) {
        int worst = -1;
        REAL most = 0;
        if (!NAME_acceleration(s->q, s->v, tau, s->mode, s->tree, acc, f, F)) return 0;
        for (int i = 0; i < NAME_DOF; i++)
            if (s->mode[i] == 0 && F[i] > 0 && NAME_abs(f[i]) - F[i] > most) {
                most = NAME_abs(f[i]) - F[i];
                worst = i;
            }
        if (worst < 0) break;
        s->mode[worst] = f[worst] > 0 ? 1 : -1;
    }
    return 1;
}

/* Begin a simulation at q and v of the independent joints; 0 where the loops do not close there. */
NAME_API int NAME_start(NAME_state *s, const REAL q[], const REAL v[])
{
    for (int j = 0; j < NAME_JOINTS; j++) s->tree[j] = NAME_assembled[j];
    for (int i = 0; i < NAME_DOF; i++) {
        s->q[i] = q[i];
        s->v[i] = v[i];
        s->mode[i] = v[i] > NAME_REST ? 1 : v[i] < -NAME_REST ? -1 : 0;
    }
    {
        REAL rates[NAME_JOINTS], Z[NAME_JOINTS * NAME_DOF], drift[NAME_JOINTS];
        return NAME_tree(s->q, s->v, s->tree, rates, Z, drift);
    }
}

/* Move for a time with constant torques of the independent joints, in steps of at most NAME_STEP;
   a step ends where a joint stops. Return 0 at a singular position, where nothing changes. */
NAME_API int NAME_step(NAME_state *state, const REAL tau[], REAL duration)
{
    NAME_state s = *state, next;
    int resting[NAME_DOF], moved = 0;
    REAL left = duration;
    for (int i = 0; i < NAME_DOF; i++) resting[i] = s.mode[i] == 0;
    if (!NAME_decide(&s, tau, resting)) return 0;
    while (left > NAME_SHORT * duration && moved++ < NAME_MOST) {
        REAL h = left < NAME_STEP ? left : NAME_STEP, low = 0;
        if (!NAME_runge_kutta(&s, tau, h, &next)) return 0;
        if (NAME_event(&s, &next, tau)) {
            REAL high = h;
            for (int k = 0; k < NAME_HALVINGS; k++) {
                const REAL middle = HALF * (low + high);
                if (!NAME_runge_kutta(&s, tau, middle, &next)) return 0;
                if (NAME_event(&s, &next, tau)) high = middle;
                else low = middle;
            }
            h = high;
            if (!NAME_runge_kutta(&s, tau, h, &next)) return 0;
        }
        for (int i = 0; i < NAME_DOF; i++) {
            resting[i] = s.mode[i] == 0 || next.v[i] * (REAL)s.mode[i] <= 0;
            if (resting[i] && NAME_has_friction[i]) next.v[i] = 0;
            else if (!NAME_has_friction[i]) resting[i] = 0;
        }
        s = next;
        if (!NAME_decide(&s, tau, resting)) return 0;
        left -= h;
    }
    *state = s;
    return 1;
}
