/* Torques of the independent joints for their motion, with all friction. `tree`: coordinates of
   all joints, first NAME_assembled, then those of the call before. 0 at a singular position. */
NAME_API int NAME_inverse_dynamics(const REAL q[], const REAL v[], const REAL a[], REAL tree[],
                                   REAL tau[])
{
    REAL rates[NAME_JOINTS], Z[NAME_JOINTS * NAME_DOF], drift[NAME_JOINTS], full[NAME_JOINTS];
    if (!NAME_tree(q, v, tree, rates, Z, drift)) return 0;
    for (int j = 0; j < NAME_JOINTS; j++)
        for (int c = 0; c < NAME_DOF; c++) drift[j] += Z[j + NAME_JOINTS * c] * a[c];
    NAME_inverse_dynamics_tree(tree, rates, drift, full);
    for (int c = 0; c < NAME_DOF; c++) {
        tau[c] = 0;
        for (int j = 0; j < NAME_JOINTS; j++) tau[c] += Z[j + NAME_JOINTS * c] * full[j];
    }
    return 1;
}

/* Torques of the independent joints that hold still. */
NAME_API int NAME_gravity(const REAL q[], REAL tree[], REAL tau[])
{
    REAL rates[NAME_JOINTS], Z[NAME_JOINTS * NAME_DOF], drift[NAME_JOINTS], full[NAME_JOINTS];
    const REAL v[NAME_DOF] = {0};
    if (!NAME_tree(q, v, tree, rates, Z, drift)) return 0;
    NAME_gravity_tree(tree, full);
    for (int c = 0; c < NAME_DOF; c++) {
        tau[c] = 0;
        for (int j = 0; j < NAME_JOINTS; j++) tau[c] += Z[j + NAME_JOINTS * c] * full[j];
    }
    return 1;
}

/* Torques of friction at the independent joints. */
NAME_API int NAME_friction(const REAL q[], const REAL v[], REAL tree[], REAL tau[])
{
    REAL rates[NAME_JOINTS], Z[NAME_JOINTS * NAME_DOF], drift[NAME_JOINTS], full[NAME_JOINTS];
    if (!NAME_tree(q, v, tree, rates, Z, drift)) return 0;
    NAME_friction_tree(rates, full);
    for (int c = 0; c < NAME_DOF; c++) {
        tau[c] = 0;
        for (int j = 0; j < NAME_JOINTS; j++) tau[c] += Z[j + NAME_JOINTS * c] * full[j];
    }
    return 1;
}

/* Y (dof, 10 bodies) of the independent joints, column by column. */
NAME_API int NAME_regressor(const REAL q[], const REAL v[], const REAL a[], REAL tree[], REAL Y[])
{
    REAL rates[NAME_JOINTS], Z[NAME_JOINTS * NAME_DOF], drift[NAME_JOINTS];
    REAL full[NAME_JOINTS * NAME_JOINTS * 10];
    if (!NAME_tree(q, v, tree, rates, Z, drift)) return 0;
    for (int j = 0; j < NAME_JOINTS; j++)
        for (int c = 0; c < NAME_DOF; c++) drift[j] += Z[j + NAME_JOINTS * c] * a[c];
    NAME_regressor_tree(tree, rates, drift, full);
    for (int k = 0; k < 10 * NAME_JOINTS; k++)
        for (int c = 0; c < NAME_DOF; c++) {
            REAL s = 0;
            for (int j = 0; j < NAME_JOINTS; j++) s += Z[j + NAME_JOINTS * c] * full[j + NAME_JOINTS * k];
            Y[c + NAME_DOF * k] = s;
        }
    return 1;
}
