"""How many threads a network runs on."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from graspmap.errors import InvalidInputError


@contextmanager
def threads_of(count: int) -> Iterator[None]:
    """So many threads of PyTorch and of OpenCV: the bits of PyTorch's sums depend on it.

    Args:
        count: 1 or more.

    Raises:
        InvalidInputError: It is less.
    """
    if count < 1:
        raise InvalidInputError("threads", count, "1 or more")
    import cv2
    import torch

    before = torch.get_num_threads(), cv2.getNumThreads()
    torch.set_num_threads(count)
    cv2.setNumThreads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before[0])
        cv2.setNumThreads(before[1])
