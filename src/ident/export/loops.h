/* Coordinates of all joints from those of the independent ones by Newton's method from `tree`,
   with their rates, d tree/d q = Z, and what accelerations have beside Z: 0 at a singular one. */
static int NAME_tree(const REAL q[], const REAL v[], REAL tree[], REAL rates[], REAL Z[],
                     REAL drift[])
{
    REAL phi[RANK], J[RANK * NAME_JOINTS], A[NAME_JOINTS * NAME_JOINTS], B[NAME_JOINTS * (NAME_DOF + 1)];
    for (int k = 0; k < 30; k++) {
        REAL most = 0;
        NAME_closure_tree(tree, phi, J);
        for (int i = 0; i < NAME_JOINTS; i++) {
            const int own = i < RANK ? 0 : NAME_independent[i - RANK];
            B[i] = i < RANK ? -phi[i] : q[i - RANK] + NAME_offset[own] - tree[own];
            most = NAME_abs(B[i]) > most ? NAME_abs(B[i]) : most;
            for (int j = 0; j < NAME_JOINTS; j++)
                A[i + NAME_JOINTS * j] = i < RANK ? J[i + RANK * j] : (REAL)(j == own);
        }
        if (!NAME_solve(NAME_JOINTS, 1, A, B)) return 0;
        for (int j = 0; j < NAME_JOINTS; j++) tree[j] += B[j];
        if (most < CLOSED) break;
        if (k == 29) return 0;
    }
    NAME_closure_tree(tree, phi, J);
    for (int pass = 0; pass < 2; pass++) {
        const int columns = pass ? 1 : NAME_DOF;
        for (int i = 0; i < NAME_JOINTS; i++) {
            const int own = i < RANK ? 0 : NAME_independent[i - RANK];
            for (int j = 0; j < NAME_JOINTS; j++)
                A[i + NAME_JOINTS * j] = i < RANK ? J[i + RANK * j] : (REAL)(j == own);
            for (int c = 0; c < columns; c++)
                B[i + NAME_JOINTS * c] = i < RANK ? (pass ? -phi[i] : 0) : (REAL)(!pass && i - RANK == c);
        }
        if (!NAME_solve(NAME_JOINTS, columns, A, B)) return 0;
        if (pass) {
            for (int j = 0; j < NAME_JOINTS; j++) drift[j] = B[j];
        } else {
            for (int j = 0; j < NAME_JOINTS; j++) {
                rates[j] = 0;
                for (int c = 0; c < NAME_DOF; c++) {
                    Z[j + NAME_JOINTS * c] = B[j + NAME_JOINTS * c];
                    rates[j] += B[j + NAME_JOINTS * c] * v[c];
                }
            }
            NAME_closure_drift_tree(tree, rates, phi);
        }
    }
    return 1;
}
