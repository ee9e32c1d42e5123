"""The check that each public door of this folder makes first: is it an array of numbers?"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from graspmap.errors import InvalidInputError


def numbers(name: str, value: ArrayLike) -> NDArray[np.float64]:
    """A copy as float64, in C order so that compiled code sees one kind of array.

    Raises:
        InvalidInputError: It is ragged, or holds something else than numbers.
    """
    try:
        return np.array(value, dtype=np.float64, order="C")
    except (TypeError, ValueError) as error:
        raise InvalidInputError(name, f"{value!r:.80}", "an array of numbers") from error
