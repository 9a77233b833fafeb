"""Types of arrays, as annotations name them."""

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

FloatArray: TypeAlias = NDArray[np.float64]
IntArray: TypeAlias = NDArray[np.int64]
BoolArray: TypeAlias = NDArray[np.bool_]
#: Indices of rows, slots or columns.
IndexArray: TypeAlias = NDArray[np.intp]
