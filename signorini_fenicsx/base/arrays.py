"""Types of NumPy arrays."""

import numpy as np
import numpy.typing as npt

type Array = npt.NDArray[np.float64]
type Indices = npt.NDArray[np.int64]
type AnyIndices = npt.NDArray[np.integer]
type Mask = npt.NDArray[np.bool_]
