"""The command line: arguments in, tables out; no mathematics.

A command has one thread of linear algebra, unless the environment says otherwise: the matrices of a
log are small, and the threads of OpenBLAS that wait for each other took 43 s of processor where one
took 8. The library changes no such setting.
"""

import os
import sys

from ident.threads import ONE_THREAD

if "numpy" not in sys.modules and not any(name in os.environ for name in ONE_THREAD):
    os.environ.update(ONE_THREAD)
