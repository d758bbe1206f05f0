"""The numerical kernel: what rows of equations say, and questions to it. It knows no robot.

`linear`: a stack of equations as a triangular factor. `blocks`: triangles by log, block of time and
coordinate, which add. `estimate`: what equations determine, weights and solution. `chance`:
standard errors, errors in time that was left out, noise. `hypotheses`: which columns explain what
is left. `time_bases`: functions of time, their coefficients eliminated. `cone`: limits.
"""
