"""What all values with one row for each of N things share: read-only columns, indexing, joining."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from graspmap.errors import InvalidInputError
from graspmap.geometry._check import numbers

Floats = NDArray[np.float64]


class Rows:
    """Base of frozen dataclasses whose fields are arrays with N rows each.

    A subclass names its fields in ``_fields`` and gives checked arrays to `_keep`.
    """

    _fields: ClassVar[tuple[str, ...]]

    def _keep(self, arrays: Iterable[Floats]) -> None:
        for name, array in zip(self._fields, arrays, strict=True):
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    def _columns(self) -> list[Floats]:
        return [getattr(self, name) for name in self._fields]

    @classmethod
    def _trusted(cls, arrays: Iterable[Floats]) -> Self:
        """From fresh arrays that come out of checked values."""
        rows = object.__new__(cls)
        rows._keep(arrays)
        return rows

    @classmethod
    def empty(cls) -> Self:
        """No rows."""
        return cls._trusted([np.zeros((0, 2)), *(np.zeros(0) for _ in cls._fields[1:])])

    @classmethod
    def concatenate(cls, parts: Iterable[Self]) -> Self:
        """All rows of ``parts``, in order."""
        items = [part._columns() for part in parts if len(part)]
        if not items:
            return cls.empty()
        return cls._trusted(np.concatenate(column) for column in zip(*items, strict=True))

    def replace(self, **changes: ArrayLike) -> Self:
        """A copy with some of the fields exchanged; one value (one point) serves all rows.

        Raises:
            InvalidInputError: A name or a shape is wrong, or a value is not allowed.
        """
        values: dict[str, Any] = dict(zip(self._fields, self._columns(), strict=True))
        unknown = changes.keys() - values.keys()
        if unknown:
            raise InvalidInputError("field", sorted(unknown), ", ".join(self._fields))
        for name, value in changes.items():
            array, shape = numbers(name, value), values[name].shape
            try:
                values[name] = np.broadcast_to(array, shape)
            except ValueError as error:
                raise InvalidInputError(f"shape of {name}", array.shape, str(shape)) from error
        return type(self)(**values)

    def __len__(self) -> int:
        return len(getattr(self, self._fields[0]))

    def __getitem__(self, index: int | slice | NDArray[Any] | list[int]) -> Self:
        """Some of the rows; a single integer gives one (N = 1)."""
        if isinstance(index, int | np.integer):
            if not -len(self) <= index < len(self):
                # Python's own protocol: iteration over a sequence ends with an IndexError.
                raise IndexError(f"row {index} of {len(self)}")
            index = slice(int(index), int(index) + 1 or None)
        elif not isinstance(index, slice):
            index = np.asarray(index, dtype=None if len(index) else np.int64)
            if index.ndim != 1:
                raise InvalidInputError("shape of the index", index.shape, "one axis")
        # Compiled code wants one kind of array: contiguous ones.
        return self._trusted(np.ascontiguousarray(column[index]) for column in self._columns())

    def __iter__(self) -> Iterator[Self]:
        return (self[i] for i in range(len(self)))

    def __reduce__(self) -> tuple[type[Self], tuple[Floats, ...]]:
        # Through the constructor: plain unpickling would leave the arrays writeable.
        return type(self), tuple(self._columns())

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, type(self)):
            return NotImplemented
        pairs = zip(self._columns(), other._columns(), strict=True)
        return all(np.array_equal(mine, theirs) for mine, theirs in pairs)

    __hash__ = None  # type: ignore[assignment]  # arrays inside


def checked(name: str, array: Floats, shape: tuple[int, ...]) -> Floats:
    """The array, if it has the shape and no NaN.

    Raises:
        InvalidInputError: It has not.
    """
    if array.shape != shape:
        raise InvalidInputError(f"shape of {name}", array.shape, f"{shape}, one row for each grasp")
    if not np.isfinite(array).all():
        raise InvalidInputError(name, "NaN or infinite in some grasp", "finite numbers")
    return array


def checked_grasps(names: tuple[str, ...], values: Iterable[Any], unit: str) -> list[Floats]:
    """Fields of N grasps as fresh arrays: centre (N, 2), angle, two sizes >= 0, quality (N,).

    Args:
        names: The five names, for errors.
        values: What was given for them; None for the quality means 1.
        unit: Of the sizes, for errors.

    Raises:
        InvalidInputError: A shape is wrong, a number is not finite, or a size is negative.
    """
    center, *others = values
    points = numbers(names[0], center)
    if points.size == 0:
        points = points.reshape(0, 2)
    if points.ndim != 2 or points.shape[1] != 2:
        raise InvalidInputError(f"shape of {names[0]}", points.shape, "(N, 2), rows (x, y)")
    count = len(points)
    arrays = [checked(names[0], points, (count, 2))]
    for name, value in zip(names[1:], others, strict=True):
        unscored = name == "quality" and value is None
        array = np.ones(count) if unscored else numbers(name, value)
        arrays.append(checked(name, array, (count,)))
    for name, sizes in zip(names[2:4], arrays[2:4], strict=True):
        if (sizes < 0).any():
            raise InvalidInputError(name, float(sizes.min()), f"{unit}, 0 or more")
    return arrays
