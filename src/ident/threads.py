"""Threads of linear algebra: the settings of the libraries that NumPy may be built with."""

LIBRARIES = ("OMP", "OPENBLAS", "MKL", "BLIS", "VECLIB_MAXIMUM", "NUMEXPR")
VARIABLES = tuple(f"{library}_NUM_THREADS" for library in LIBRARIES)
# the matrices of a log are small: threads that wait for each other cost more than they bring, and
# two processes with two threads each are slower on two cores than with one each
ONE_THREAD = dict.fromkeys(VARIABLES, "1")
