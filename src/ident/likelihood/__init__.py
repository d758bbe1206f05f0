"""Errors in variables: torques and motion weighed against each other, as maximum likelihood asks.

    min over x, c     |U (c − ĉ)|²  +  Σ |b(c) − A(c) x|² / σ²

The smooth motion u = B c may move within what its channels allow (U, ĉ: `motion.spline`) where
that makes the torques agree. Linear in (x, c − c₀), these are rows [A/σ | −G B/σ] with a band in c,
and c is eliminated as multipliers are (`solve.eliminate`): what is left are equations of x alone,
whitened by the noise of torques and motion together.

Sources: W. Fuller, Measurement Error Models, 1987, sect. 3.2 (functional model); K. Schittkowski,
Numerical Data Fitting in Dynamical Systems, 2002; direct collocation as in L. Biegler, Nonlinear
Programming, 2010, ch. 10, with the equations of motion weighed by the noise of torques in place of
held exactly.
"""
