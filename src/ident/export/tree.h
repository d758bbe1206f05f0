static int NAME_tree(const REAL q[], const REAL v[], REAL tree[], REAL rates[], REAL Z[],
                     REAL drift[])
{
    for (int j = 0; j < NAME_JOINTS; j++) {
        tree[j] = q[j] + NAME_offset[j];
        rates[j] = v[j];
        drift[j] = 0;
        for (int c = 0; c < NAME_DOF; c++) Z[j + NAME_JOINTS * c] = (REAL)(j == c);
    }
    return 1;
}
