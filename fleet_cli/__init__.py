"""The command ``fleet``: thin; it parses, starts and prints."""

import os

# Matrices here are small and many: a pool of BLAS threads only takes cores away from the other processes.
for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
