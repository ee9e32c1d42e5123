"""Losses of the auxiliary tasks: saliency, depth, category, graspness, orientation.

Each picture's loss is a mean over those of its pixels where the truth is known, and the loss of a
batch is the mean over its pictures, so it does not depend on which pictures share a batch. What is
not known has no gradient.

Letters in shapes: B pictures, K classes, N orientation bins, H rows, W columns.

References:
    Thesis, Eq. 3.9 (category), 3.13 to 3.17 (saliency, depth). Eq. 3.14 writes a sum over the
    pixels where a mean is taken here, as in all other losses. Pang, Zhao, Zhang, Lu: Multi-scale
    interactive network for salient object detection, CVPR 2020 (CEL). Chalvatzaki, Gkanatsios,
    Maragos, Peters: Orientation attentive robotic grasp synthesis with augmented grasp map
    representation, 2020 (graspness, orientation).
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Any, Literal, get_args

import torch
from torch import Tensor, nn
from torch.nn.functional import (
    binary_cross_entropy_with_logits,
    cross_entropy,
    mse_loss,
    smooth_l1_loss,
)

from graspmap.errors import InvalidInputError, UnknownNameError

SaliencyKind = Literal["mse", "bce", "bce_cel"]
"""Square of the probability's error; binary cross-entropy; that and CEL, one to one."""

DepthKind = Literal["mse", "smooth_l1"]
"""Error of one pixel: e^2, or 0.5 e^2 below 1 and |e| - 0.5 above."""

UNKNOWN = -1
"""Class of a picture whose class is not known."""


class SaliencyLoss(nn.Module):
    r"""How far the probability of each pixel to show an object is from the mask.

    With p = sigmoid(logit) and g the mask: ``mse`` is mean((p - g)^2), ``bce`` is
    mean(-(g log p + (1 - g) log(1 - p))), computed from the logits so that it stays finite and
    keeps its gradient however sure the network is, and ``bce_cel`` adds `cel` with weight 1.

    Args:
        kind: One of these.

    Raises:
        UnknownNameError: It is not.
    """

    def __init__(self, kind: SaliencyKind = "bce") -> None:
        super().__init__()
        self.kind = _checked("loss of saliency", kind, get_args(SaliencyKind))

    def forward(self, logits: Tensor, mask: Tensor, known: Tensor | None = None) -> Tensor:
        """The loss of a batch, a scalar.

        Args:
            logits: (B, 1, H, W).
            mask: (B, 1, H, W) 1 (or True) on the object, 0 beside it.
            known: (B, 1, H, W) bool where the mask is known; None for everywhere.

        Raises:
            InvalidInputError: The shapes differ.
        """
        check_shapes("saliency", logits, mask, known)
        truth = mask.to(logits.dtype)
        if self.kind == "mse":
            return mean_over(mse_loss(logits.sigmoid(), truth, reduction="none"), known)
        entropy = binary_cross_entropy_with_logits(logits, truth, reduction="none")
        loss = mean_over(entropy, known)
        return loss if self.kind == "bce" else loss + cel(logits.sigmoid(), truth, known)

    def extra_repr(self) -> str:
        """Kind, for printing."""
        return f"kind={self.kind!r}"


def cel(probability: Tensor, mask: Tensor, known: Tensor | None = None) -> Tensor:
    """Consistency-enhanced loss (Eq. 3.15): (sum(p - p g) + sum(g - p g)) / (sum p + sum g).

    For binary pictures it is (FP + FN) / (FP + 2 TP + FN), which is 1 minus the Dice coefficient.
    It looks at the whole picture, so it does not fade where the object is small.

    Args:
        probability: (B, 1, H, W) p, 0 to 1.
        mask: (B, 1, H, W) g, 0 to 1.
        known: (B, 1, H, W) bool where g is known; None for everywhere.

    Returns:
        Scalar from 0 to 1, the mean over the pictures; 0 for a picture that is empty in both.
    """
    p, g = probability, mask
    if known is not None:
        p, g = p * known, g * known
    both, ps, gs = ((x).flatten(1).sum(1) for x in (p * g, p, g))
    # A picture without any object: p sums to (nearly) 0 only where the network says so too.
    return ((ps - both + gs - both) / (ps + gs).clamp_min(torch.finfo(p.dtype).tiny)).mean()


class DepthLoss(nn.Module):
    """How far the depth is from the true one, where there is a measurement.

    Both are in units of the network's depth input: metres, the picture's mean subtracted, clipped
    to [-1, 1].

    Args:
        kind: Error of one pixel.

    Raises:
        UnknownNameError: There is no such error.
    """

    def __init__(self, kind: DepthKind = "mse") -> None:
        super().__init__()
        self.kind = _checked("loss of depth", kind, get_args(DepthKind))

    def forward(self, depth: Tensor, truth: Tensor, known: Tensor | None = None) -> Tensor:
        """The loss of a batch, a scalar.

        Args:
            depth: (B, 1, H, W) what the network says.
            truth: (B, 1, H, W) the true depth, finite also where it is not known.
            known: (B, 1, H, W) bool where it is known; None for everywhere.

        Raises:
            InvalidInputError: The shapes differ.
        """
        check_shapes("depth", depth, truth, known)
        error = mse_loss if self.kind == "mse" else smooth_l1_loss
        return mean_over(error(depth, truth.to(depth.dtype), reduction="none"), known)

    def extra_repr(self) -> str:
        """Kind, for printing."""
        return f"kind={self.kind!r}"


class CategoryLoss(nn.Module):
    """Cross-entropy between the classes that the network says and the true one.

    The thesis writes a sigmoid before the negative log-likelihood; a class is one of several that
    exclude each other, so it is a softmax here.
    """

    def forward(self, logits: Tensor, classes: Tensor) -> Tensor:
        """The loss of a batch, a scalar: the mean over pictures with a known class.

        Args:
            logits: (B, K).
            classes: (B,) integers 0 to K - 1; `UNKNOWN` leaves a picture out.

        Raises:
            InvalidInputError: The shapes do not fit together, or a class is not one of the K.
        """
        if logits.ndim != 2 or classes.shape != logits.shape[:1]:
            raise InvalidInputError(
                "shapes of category (logits, classes)",
                (tuple(logits.shape), tuple(classes.shape)),
                "(B, K) and (B,)",
            )
        if len(classes) and not UNKNOWN <= int(classes.min()) <= int(classes.max()) < len(logits.T):
            raise InvalidInputError(
                "classes",
                f"{int(classes.min())} to {int(classes.max())}",
                f"{UNKNOWN} (not known) to {logits.shape[1] - 1}",
            )
        total = cross_entropy(logits, classes, ignore_index=UNKNOWN, reduction="sum")
        return total / (classes != UNKNOWN).sum().clamp_min(1)


class BinLoss(nn.Module):
    """Binary cross-entropy of graspness or of orientation against what the target maps say.

    A pixel is graspable where the drawn quality is above 0, in a bin or, for graspness, in any;
    several bins may be at once. How high a soft or strong quality is does not count: the question
    is whether a grasp is centred there, and a loss against 0.9 could never become 0.

    Args:
        any_bin: For graspness: the bins are taken together.
    """

    def __init__(self, *, any_bin: bool) -> None:
        super().__init__()
        self.any_bin = any_bin

    def forward(self, logits: Tensor, quality: Tensor) -> Tensor:
        """The loss of a batch, a scalar.

        Args:
            logits: (B, 1, H, W) for graspness, (B, N, H, W) for orientation.
            quality: (B, N, H, W) drawn quality.

        Raises:
            InvalidInputError: The shapes do not fit together.
        """
        graspable = quality > 0
        if self.any_bin:
            graspable = graspable.any(dim=1, keepdim=True)
        check_shapes("graspness" if self.any_bin else "orientation", logits, graspable)
        return binary_cross_entropy_with_logits(logits, graspable.to(logits.dtype))

    def extra_repr(self) -> str:
        """Whether the bins are taken together, for printing."""
        return f"any_bin={self.any_bin}"


def mean_over(values: Tensor, known: Tensor | None = None) -> Tensor:
    """Mean over each picture's known pixels, then over the pictures.

    Args:
        values: (B, 1, H, W).
        known: (B, 1, H, W) bool; None for all.

    Returns:
        Scalar; a picture without a known pixel counts as 0.
    """
    if known is None:
        return values.mean()
    counts = known.flatten(1).sum(1).clamp_min(1)
    return (torch.where(known, values, 0).flatten(1).sum(1) / counts).mean()


def check_shapes(task: str, said: Tensor, truth: Tensor, known: Tensor | None = None) -> None:
    """See that what is compared has one shape, (B, channels, H, W).

    Raises:
        InvalidInputError: It has not.
    """
    shapes = {tuple(t.shape) for t in (said, truth, known) if t is not None}
    if len(shapes) > 1 or said.ndim != 4:
        raise InvalidInputError(
            f"shapes of {task} (said, true, known)",
            tuple(tuple(t.shape) for t in (said, truth, known) if t is not None),
            "one shape (B, channels, H, W)",
        )


def _checked(what: str, name: Any, known: Collection[str]) -> Any:
    if name not in known:
        raise UnknownNameError(what, str(name), known)
    return name
