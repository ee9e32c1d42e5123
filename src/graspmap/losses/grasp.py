"""The grasp loss: how far predicted grasp maps are from drawn ones.

Letters in shapes: B pictures, N orientation bins, H rows, W columns.
"""

from __future__ import annotations

from typing import Literal, NamedTuple, get_args

import torch
from torch import Tensor, nn
from torch.nn.functional import mse_loss, smooth_l1_loss

from graspmap.errors import InvalidInputError, UnknownNameError
from graspmap.maps.grasp_maps import GraspMaps

Base = Literal["mse", "smooth_l1"]
"""Error of one pixel: e^2, or 0.5 e^2 below 1 and |e| - 0.5 above."""

Positional = Literal["none", "inside", "outside", "normalised"]
"""Where the errors of angle and width count, see `GraspLoss`."""


class GraspLossTerms(NamedTuple):
    """The loss and its parts, scalars; ``total`` is N times the sum of the four others."""

    total: Tensor
    quality: Tensor
    cos: Tensor
    sin: Tensor
    width: Tensor


class GraspLoss(nn.Module):
    r"""Sum of the mean errors of the four maps, times the number of bins.

    With l the error of one pixel (``base``), p a predicted and t a true map, Q the true quality
    and mean over all B N H W pixels, the quality term is always mean(l(p - t)). The terms of
    cos, sin and width are

    - ``none``: mean(l(p - t)), Eq. 4.2 and 5.5;
    - ``inside``: mean(l(Q p - Q t)), the positional loss as it was trained (Eq. 4.5). With
      ``mse`` the weight of a pixel is Q squared;
    - ``outside``: mean(Q l(p - t)), the positional loss as Eq. 5.6 writes it;
    - ``normalised``: sum(Q l(p - t)) / sum(Q), the same weights, but the number of graspable
      pixels (under 1 % of a picture) no longer scales the terms. 0 where Q is 0 everywhere.

    For a binary Q, ``inside`` and ``outside`` are equal. With the three positional forms the
    maps of angle and width are free wherever Q is 0.

    A width that is too small costs a grasp, for a finger comes down on the object; one that is
    too large mostly costs nothing. ``width_expectile`` t above 0.5 makes the network say an upper
    expectile of the widths that were labelled, not their mean: errors of the width below the truth
    count 2 t times, those above it 2 (1 - t) times.

    Args:
        base: Error of one pixel.
        positional: Where angle and width count.
        width_expectile: t, between 0 and 1; 0.5 is the published loss.

    Raises:
        UnknownNameError: A name is not one of these.
        InvalidInputError: The expectile is not between 0 and 1.

    References:
        Thesis, Eq. 4.1 to 4.5 and 5.5, 5.6. Eq. 4.4 lacks the square of the small branch.
        Newey, Powell: Asymmetric least squares estimation and testing, Econometrica 1987
        (expectiles).
    """

    def __init__(
        self,
        base: Base = "mse",
        positional: Positional = "none",
        *,
        width_expectile: float = 0.5,
    ) -> None:
        super().__init__()
        for what, value, known in (("base", base, Base), ("positional", positional, Positional)):
            if value not in get_args(known):
                raise UnknownNameError(f"{what} of the loss", str(value), get_args(known))
        if not 0 < width_expectile < 1:
            raise InvalidInputError("width_expectile", width_expectile, "a number between 0 and 1")
        self.base, self.positional, self.width_expectile = base, positional, width_expectile

    def forward(self, predicted: GraspMaps[Tensor], target: GraspMaps[Tensor]) -> GraspLossTerms:
        """The loss of a batch.

        Args:
            predicted: (B, N, H, W) maps of a network.
            target: (B, N, H, W) drawn maps.

        Returns:
            Scalars in the wider of the two types, so half-precision maps lose nothing more.

        Raises:
            InvalidInputError: The shapes differ.
        """
        if predicted.quality.shape != target.quality.shape:
            raise InvalidInputError(
                "shape of the predicted maps",
                tuple(predicted.quality.shape),
                f"that of the target, {tuple(target.quality.shape)}",
            )
        kind = torch.promote_types(predicted.quality.dtype, target.quality.dtype)
        pairs = [(p.to(kind), t.to(kind)) for p, t in zip(predicted, target, strict=True)]
        weight = pairs[0][1]
        terms = [
            self._error(*pairs[0], reduction="mean"),
            *(self._positional(p, t, weight) for p, t in pairs[1:3]),
            self._positional(*pairs[3], weight, self.width_expectile),
        ]
        return GraspLossTerms(target.bins * torch.stack(terms).sum(), *terms)

    def _positional(
        self, predicted: Tensor, target: Tensor, weight: Tensor, expectile: float = 0.5
    ) -> Tensor:
        if self.positional == "inside":
            predicted, target = weight * predicted, weight * target
        error = self._error(predicted, target, reduction="none")
        if expectile != 0.5:
            error = error * torch.where(predicted < target, 2 * expectile, 2 - 2 * expectile)
        if self.positional in ("none", "inside"):
            return error.mean()
        weighted = weight * error
        if self.positional == "outside":
            return weighted.mean()
        return weighted.sum() / weight.sum().clamp_min(torch.finfo(weight.dtype).tiny)

    def _error(self, predicted: Tensor, target: Tensor, reduction: str) -> Tensor:
        function = mse_loss if self.base == "mse" else smooth_l1_loss
        return function(predicted, target, reduction=reduction)

    def extra_repr(self) -> str:
        """Base, positional form and expectile, for printing."""
        return (
            f"base={self.base!r}, positional={self.positional!r}, "
            f"width_expectile={self.width_expectile:g}"
        )
