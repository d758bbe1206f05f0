/* --- drives: torques from commands ---------------------------------------------------------- */

/* The commands of the last NAME_HELD cycles, of which each drive follows a late one. All zero at
   first: static NAME_drives drives; */
typedef struct {
    REAL time[NAME_HELD];
    REAL command[NAME_HELD][NAME_DOF]; /* ref [rad | m], current [A] or voltage [V] */
    REAL rate[NAME_HELD][NAME_DOF];
    REAL feedforward[NAME_HELD][NAME_DOF];
    int count; /* of commands that are held */
    int newest;
} NAME_drives;

/* Keep the commands of a cycle at time t [s], which does not decrease; rate or feedforward may be
   0 where there is none. */
NAME_API void NAME_drives_command(NAME_drives *drives, REAL t, const REAL command[],
                                  const REAL rate[], const REAL feedforward[])
{
    const int k = drives->count ? (drives->newest + 1) % NAME_HELD : 0;
    drives->newest = k;
    if (drives->count < NAME_HELD) drives->count++;
    drives->time[k] = t;
    for (int j = 0; j < NAME_DOF; j++) {
        drives->command[k][j] = command[j];
        drives->rate[k][j] = rate ? rate[j] : NAME_ZERO;
        drives->feedforward[k][j] = feedforward ? feedforward[j] : NAME_ZERO;
    }
}

/* Torques of the drives at time t in the state q, v as it is logged: within limits, and 0 of a joint
   without a drive. Returns 0 if a delay is longer than the cycles that are held, with the oldest
   command then, or if there is no command yet. */
NAME_API int NAME_drives_torque(const NAME_drives *drives, REAL t, const REAL q[], const REAL v[],
                                REAL tau[])
{
    int held = drives->count > 0;
    for (int j = 0; j < NAME_DOF; j++) {
        int k = drives->newest, back = 0;
        REAL x;
        tau[j] = NAME_ZERO;
        if (!drives->count) continue;
        while (drives->time[k] > t - NAME_delay[j] + NAME_SHORT && back + 1 < drives->count) {
            k = (k + NAME_HELD - 1) % NAME_HELD;
            back++;
        }
        if (drives->time[k] > t - NAME_delay[j] + NAME_SHORT && drives->count == NAME_HELD) held = 0;
        x = NAME_scale[j] * drives->command[k][j] + NAME_follows[j] * drives->rate[k][j]
            - NAME_stiffness[j] * q[j] - NAME_damping[j] * v[j];
        if (NAME_driven[j]) x += drives->feedforward[k][j];
        tau[j] = x > NAME_limit[j] ? NAME_limit[j] : x < -NAME_limit[j] ? -NAME_limit[j] : x;
    }
    return held;
}
