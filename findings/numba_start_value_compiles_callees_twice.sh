#!/usr/bin/env bash
# Library: numba 0.68.1.
# Expected: `n = 0` before a loop that says `n = step(n)` makes n an int64, and `step` is compiled for int64 once.
# Happens: while Numba guesses the type of n it compiles `step`, and all that `step` calls, for Literal[int](0) first,
#   then for int64. The first code is never called by anything, and is kept by the dispatcher and on disk with
#   cache=True. A constant in the call, `step(0)`, does the same, and that one is called. Starting from a module's
#   np.int64(0) compiles it once.
# Matters: time to compile. A chain of kernels below such a loop takes twice as long, whatever its depth, and nothing
#   says so but the list of signatures. Give loops typed start values, and count signatures in a test.
set -euo pipefail
tmp=$(mktemp -d)
trap 'rm -rf "$tmp"' EXIT
python3 -m venv "$tmp/venv"
"$tmp/venv/bin/pip" install --quiet --quiet --no-compile --disable-pip-version-check \
    numba==0.68.1 numpy==2.4.6
cat > "$tmp/probe.py" <<'PYTHON'
import sys

import numba
import numpy as np

ZERO = np.int64(0)


def kernels():
    @numba.njit
    def below(n):
        return n + 1

    @numba.njit
    def step(n):
        return below(n)

    return below, step


def signatures(*functions):
    return [sorted(str(one[0]) for one in function.signatures) for function in functions]


below, step = kernels()


@numba.njit
def plain(times):
    n = 0
    for _ in range(times):
        n = step(n)
    return n


assert plain(3) == 3
found = signatures(step, below)
below, step = kernels()


@numba.njit
def typed(times):
    n = ZERO
    for _ in range(times):
        n = step(n)
    return n


assert typed(3) == 3
once = signatures(step, below)
print("numba", numba.__version__, "| n = 0:", found, "| n = np.int64(0):", once)
twice = ["Literal[int](0)", "int64"]
if found != [twice, twice] or once != [["int64"], ["int64"]]:
    sys.exit("this has changed")
PYTHON
"$tmp/venv/bin/python" "$tmp/probe.py"
