/* A loop of 1 kHz on exported code: computed torque on the arm of robots/arm.

       ident export robots/arm --set ... --to c --out arm.h
       gcc -std=c99 -O2 -Wall -Wextra -Wconversion -Werror -I. -o loop control_loop.c -lm && ./loop

   The machine is the header's own simulation here; on a robot its encoders and its drives are in the
   place of arm_step. Nothing in the loop allocates memory, locks or waits. */
#include <stdio.h>

#include "arm.h"

#define PERIOD 0.001 /* s */
#define KP 400.0     /* 1/s^2: 20 rad/s, critically damped */
#define KD 40.0      /* 1/s */

/* The wanted motion: positions, rates and accelerations at a time. */
static void reference(double t, double q[], double v[], double a[])
{
    for (int j = 0; j < arm_JOINTS; j++) {
        const double w = 1.5 + 0.3 * j;
        q[j] = 0.3 * (1.0 - cos(w * t));
        v[j] = 0.3 * w * sin(w * t);
        a[j] = 0.3 * w * w * cos(w * t);
    }
}

int main(void)
{
    const double rest[arm_JOINTS] = {0};
    double q[arm_JOINTS], v[arm_JOINTS], a[arm_JOINTS], tau[arm_JOINTS], worst = 0.0;
    arm_state machine;
    if (!arm_start(&machine, rest, rest)) return 1;
    for (int k = 0; k < 2000; k++) {
        reference(k * PERIOD, q, v, a);
        for (int j = 0; j < arm_JOINTS; j++) {
            const double error = q[j] - machine.q[j];
            a[j] += KP * error + KD * (v[j] - machine.v[j]);
            if (error > worst) worst = error;
            if (-error > worst) worst = -error;
        }
        /* inertia and gravity at the measured state; friction of the wanted speed, as the measured
           one changes its sign with every bit of the encoder */
        arm_inverse_dynamics(machine.q, v, a, tau);
        if (!arm_step(&machine, tau, PERIOD)) return 1;
    }
    printf("largest error %.3g rad\n", worst);
    return worst < 0.005 ? 0 : 1;
}
