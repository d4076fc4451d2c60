"""Compiled loops over pixels, and the vector values that they are made of."""

import gc
import sys

#: numba imports it only to note that it is there, which takes a tenth of the processor time of a short run.
_BLAS = "scipy.linalg.cython_blas"

if "numba" not in sys.modules and _BLAS not in sys.modules:
    sys.modules[_BLAS] = None  # type: ignore[assignment]  # as if it were missing
    collecting = gc.isenabled()
    gc.disable()  # it would search the many new objects again and again
    import numba.np.arraymath

    if collecting:
        gc.enable()
    del sys.modules[_BLAS]
    numba.np.arraymath._HAVE_BLAS = True  # a kernel that needs it imports it then
