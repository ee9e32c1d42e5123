"""How the loops of this folder are compiled: with the same bits as the result everywhere."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

Function = TypeVar("Function", bound=Callable[..., Any])


def compiled(function: Function) -> Function:
    """Compile a function at its first call.

    Sums and products stay in the order written (no fast mathematics), and each is rounded by
    itself; a division by zero gives infinity and costs no check.
    """
    return cast(Function, numba.njit(cache=True, nogil=True, error_model="numpy")(function))
