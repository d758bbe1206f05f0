"""The numerical kernel: sparse least squares by orthogonal transformations. It knows no robot.

`factor`: all that a stack of equations says, in a triangle. `rank`: what it determines, and the
solution. `basis`: functions of time. `chunk`, `eliminate`: multipliers on a basis eliminated, and
found again; `stretch`: the same in pieces of any split that merge. `covariance`: how sure they are.
`samplewise`: free multipliers, one value a sample.
"""
