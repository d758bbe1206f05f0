"""The numerical kernel: what rows of equations say, and questions to it. It knows no robot.

`triangle`: a stack of equations as a triangular factor. `blocks`: triangles by log, block of time
and coordinate, which add. `base`: what equations determine. `estimate`: weights and solution.
`held_out`: errors in time that was left out. `covariance`: standard errors from blocks of time.
`splines`, `band`: functions of time, and their coefficients eliminated. `cone`: least squares
within limits.
"""
