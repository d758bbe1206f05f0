"""The numerical kernel: what rows of equations say, and questions to it. It knows no robot.

`triangle`: a stack of equations as a triangular factor. `blocks`: triangles by log, block of time
and coordinate, which add. `estimate`: what equations determine, weights and solution.
`covariance`: standard errors from blocks of time, and errors in time that was left out.
`splines`, `band`: functions of time, and their coefficients eliminated. `cone`: least squares
within limits.
"""
