"""The experiment: everything that decides a training run, as one strict YAML file.

A wrong key is an error that names the nearest right one, a wrong value one that says what is
allowed. Flags of the command line are the same keys, dotted: ``--training.epochs 10``.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Annotated, Any, Literal

import yaml
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from graspmap.data.windows import View

Positive = Annotated[int, Field(ge=1)]
Fraction = Annotated[float, Field(ge=0, le=1)]
PositiveFloat = Annotated[float, Field(gt=0)]
Zoom = Annotated[float, Field(ge=0.05, le=20)]


class _Section(BaseModel):
    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, allow_inf_nan=False)


def _as_text(value: Any) -> Any:
    """Numbers as text: YAML and the command line read 32 as a number."""
    return str(value) if type(value) is int else value


class NetworkSection(_Section):
    """Which network, and what it sees.

    Attributes:
        name: Name in `graspmap.networks.NETWORKS`.
        channels: Pictures it looks at.
        bins: Orientation bins N; each head has N channels.
        filters: Filters of the first layer, of networks that leave them open; null takes the
            network's own.
    """

    name: str = "ggcnn2"
    channels: Literal["depth", "rgb", "rgbd"] = "depth"
    bins: Annotated[int, Field(ge=1, le=1024)] = 1
    filters: Annotated[int, Field(ge=1, le=256)] | None = None


class SaliencyTask(_Section):
    """The network also says which pixels show the object; see `graspmap.losses.SaliencyLoss`.

    Attributes:
        loss: Error of the probability: its square, its binary cross-entropy, or that and the
            consistency-enhanced loss over the picture.
    """

    loss: Literal["mse", "bce", "bce_cel"] = "bce"


class DepthTask(_Section):
    """The network also says the depth, normalised; see `graspmap.losses.DepthLoss`.

    Attributes:
        loss: Error of one pixel.
    """

    loss: Literal["mse", "smooth_l1"] = "mse"


class CategoryTask(_Section):
    """The network also says what the object is.

    Attributes:
        labels: Which of a scene's labels is the class, ``"specific"`` (mug) or ``"general"``
            (crockery).
    """

    labels: Literal["specific", "general"] = "specific"


class GraspnessTask(_Section):
    """The network also says where a grasp of any angle is."""


class OrientationTask(_Section):
    """The network also says which orientation bins hold a grasp, pixel by pixel."""


class TasksSection(_Section):
    """What the network learns beside grasps; null is not learned, ``{}`` is learned by default.

    Attributes:
        category: See `CategoryTask`; needs scenes with labels.
        saliency: See `SaliencyTask`; needs scenes with masks.
        depth: See `DepthTask`; needs scenes with depth.
        graspness: See `GraspnessTask`.
        orientation: See `OrientationTask`; needs two bins or more.
    """

    category: CategoryTask | None = None
    saliency: SaliencyTask | None = None
    depth: DepthTask | None = None
    graspness: GraspnessTask | None = None
    orientation: OrientationTask | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """The tasks that are learned, in this order."""
        return tuple(name for name in type(self).model_fields if getattr(self, name) is not None)


class SplitSection(_Section):
    """Which scenes are trained on, chosen with, and tested once.

    Attributes:
        by: ``"object"`` keeps all scenes of an object in one part; ``"image"`` does not.
        seed: Seed of the shuffle; null takes the experiment's.
        train: Share of the scenes to train on.
        validation: Share that chooses the best epoch and steers the learning rate.
        test: Share that is looked at once, at the end.
        folds: Number k of folds in place of the shares, or null: each fold holds 1/k of the
            scenes out, half of them for validation and half for the test.
        fold: Which of the k folds is held out, 0 to k - 1.
        file: A split file to use in place of all the above, or null.
        limit_objects: The training part keeps the scenes of this many of its objects only (by
            image: this many scenes), drawn with the seed; fewer are always some of more. Null
            keeps all.
    """

    by: Literal["object", "image"] = "object"
    seed: Annotated[int, Field(ge=0)] | None = None
    train: Fraction = 0.8
    validation: Fraction = 0.1
    test: Fraction = 0.1
    folds: Annotated[int, Field(ge=2)] | None = None
    fold: Annotated[int, Field(ge=0)] = 0
    file: str | None = None
    limit_objects: Positive | None = None

    @model_validator(mode="after")
    def _check(self) -> SplitSection:
        total = self.train + self.validation + self.test
        if self.folds is None and not math.isclose(total, 1.0, abs_tol=1e-6):
            raise ValueError(
                f"allowed: shares train, validation, test that are 1 in sum, not {total:g}"
            )
        if self.folds is not None and self.fold >= self.folds:
            raise ValueError(f"allowed: fold from 0 to {self.folds - 1}, not {self.fold}")
        return self


class AugmentSection(_Section):
    """How a training picture is moved; the grasps move with it.

    Attributes:
        rotation: Any angle, multiples of 90 degrees, or none.
        zoom: Share of the picture's side that fills the frame, drawn from (low, high).
        flip: Whether half of the pictures are mirrored.
        shift: Greatest shift, as a share of the picture's side.
        crop: Side in input pixels of a square that is cut out of the moved picture, three times of
            four around a pixel where a grasp may be centred: where objects are small in the
            picture, a step costs a fraction of the time, and more of it is spent on them. Null
            takes the whole picture.
    """

    rotation: Literal["any", "quarter", "none"] = "any"
    zoom: tuple[Zoom, Zoom] = (0.5, 1.0)
    flip: bool = False
    shift: Annotated[float, Field(ge=0, le=1)] = 0.0
    crop: Annotated[int, Field(ge=16)] | None = None

    @model_validator(mode="after")
    def _check(self) -> AugmentSection:
        if self.zoom[0] > self.zoom[1]:
            raise ValueError(f"allowed: zoom [low, high] in this order, not {list(self.zoom)}")
        return self


class TestSection(_Section):
    """Another data set to test on, to see what carries over.

    Its labelled scenes are the test. Its pictures become inputs by the same rule (size and
    view), and the width scale stays that of the training data: it is the unit in which the network
    speaks, and both are input pixels.

    Attributes:
        source: ``kind:directory``.
        depth: Which of the depths that the kind offers, or null for its default.
        view: Its own centre window, see `DataSection`; null takes that of the training data.
        limit_objects: Tests on this many of its objects only, drawn with the seed; null on all.
    """

    __test__ = False  # pytest takes the name for a test

    source: str
    depth: Literal["perfect", "stereo", "z", "range"] | None = None
    view: View | None = None
    limit_objects: Positive | None = None


class ValidationSection(_Section):
    """A data set of its own to choose the epoch with, for data that come in parts.

    Then all of `DataSection.source` is trained on, and `DataSection.test` is the test: nothing is
    divided. The pictures become inputs by the same rule as those of the training part.

    Attributes:
        source: ``kind:directory``.
        depth: Which of the depths that the kind offers, or null for its default.
    """

    source: str
    depth: Literal["perfect", "stereo", "z", "range"] | None = None


class DataSection(_Section):
    """Where the scenes are and how they become the network's input.

    Attributes:
        source: ``kind:directory``; a relative directory is seen from the working directory.
        depth: Which of the depths that the kind offers, or null for its default.
        size: Side of the input, pixels.
        depth_zero: What depth is measured from: ``"mean"``, its mean as published, or
            ``"table"``, the table's behind each pixel; see `graspmap.data.to_input`.
        view: Centre window of the picture that fills the input: its longer side
            (``"contain"``), its shorter side (``"cover"``), or so many pixels; ``"36 cm"``: a
            close-up of what stands on the table, see `graspmap.data.input_window`.
        split: See `SplitSection`.
        augment: See `AugmentSection`; training part only.
        validation: See `ValidationSection`; null chooses with the split's validation part.
        test: See `TestSection`; null tests on the split's test part.
        cache_dir: Folder of the packed cache; null takes ``$GRASPMAP_CACHE`` or the user's cache
            folder.
    """

    source: str
    depth: Literal["perfect", "stereo", "z", "range"] | None = None
    size: Annotated[int, Field(ge=16, le=4096)] = 300
    depth_zero: Literal["mean", "table"] = "mean"
    view: View = "contain"
    split: SplitSection = SplitSection()
    augment: AugmentSection = AugmentSection()
    validation: ValidationSection | None = None
    test: TestSection | None = None
    cache_dir: str | None = None

    @model_validator(mode="after")
    def _check(self) -> DataSection:
        if self.augment.crop is not None and self.augment.crop > self.size:
            raise ValueError(
                f"allowed: augment.crop up to size, {self.size} px, not {self.augment.crop}"
            )
        return self


class MapsSection(_Section):
    """How the target maps are drawn; see `graspmap.maps.draw_maps`.

    Attributes:
        quality: Kind of quality target.
        peaks: How good a label is at best: ``one``: all are; ``jaws``: by the share of the jaw
            sizes that held there (see `graspmap.data.jaw_shares`), which says how safe it is.
        drop_off: Relative drop-off g of the Gaussian.
        overlap: Which grasp gives angle and width where several overlap.
        gaussian: Frame in which the Gaussian is drawn.
        background: Angle and width outside all grasps.
        width_scale: Opening in input pixels that the width map shows as 1; ``"data"`` takes the
            greatest one labelled in the training part.
    """

    quality: Literal["binary", "soft", "strong"] = "binary"
    peaks: Literal["one", "jaws"] = "one"
    drop_off: PositiveFloat = 2.0
    overlap: Literal["best", "published"] = "best"
    gaussian: Literal["grasp", "published"] = "grasp"
    background: Literal["zero", "published"] = "zero"
    width_scale: Literal["data"] | PositiveFloat = "data"


class LossSection(_Section):
    """What is minimised; see `graspmap.losses.MultiTaskLoss`.

    Attributes:
        base: Error of one pixel of the grasp maps.
        positional: Whether, and how, angle and width count only where grasps are.
        width_expectile: Above 0.5 the network learns wide openings of those that were labelled
            rather than middling ones; see `graspmap.losses.GraspLoss`.
        weighting: How the losses of several tasks become one: their sum, shares that are fixed,
            or weights that are learned (task uncertainty).
        grasp_share: Share of the grasp loss with ``"fixed"``; the other tasks have the rest.
    """

    base: Literal["mse", "smooth_l1"] = "mse"
    positional: Literal["none", "inside", "outside", "normalised"] = "inside"
    width_expectile: Annotated[float, Field(gt=0, lt=1)] = 0.5
    weighting: Literal["sum", "fixed", "uncertainty"] = "sum"
    grasp_share: Fraction = 0.5


class OptimiserSection(_Section):
    """How the weights move.

    Attributes:
        name: Optimiser.
        learning_rate: Its first learning rate; the greatest one with a cosine.
        weight_decay: Its weight decay.
    """

    name: Literal["adam", "adamw", "sgd"] = "adam"
    learning_rate: PositiveFloat = 1e-3
    weight_decay: Annotated[float, Field(ge=0)] = 0.0


class ScheduleSection(_Section):
    """How the learning rate falls.

    Attributes:
        kind: ``"plateau"`` cuts it when validation no longer improves; ``"cosine"`` lets it rise
            over the first `warmup` of all steps and fall to nothing at the last one, along half a
            cosine; ``"none"`` keeps it.
        warmup: Share of all steps (those of `TrainingSection.epochs`) in which a cosine rises.
        monitor: What has to improve: the validation loss or its rectangle success.
        factor: A cut multiplies the learning rate by this.
        patience: Epochs without improvement that are let pass before a cut.
        stop_after_cuts: Training ends instead of making cut number ``stop_after_cuts + 1``; null
            never ends it.
    """

    kind: Literal["plateau", "cosine", "none"] = "plateau"
    warmup: Annotated[float, Field(ge=0, lt=1)] = 0.1
    monitor: Literal["loss", "success"] = "loss"
    factor: Annotated[float, Field(gt=0, lt=1)] = 0.3
    patience: Annotated[int, Field(ge=0)] = 3
    stop_after_cuts: Positive | None = None


class TrainingSection(_Section):
    """How long and on what.

    Attributes:
        epochs: Greatest number of epochs; 0 writes the untrained network.
        batch_size: Pictures a step.
        batches_per_epoch: Steps an epoch; null goes once over the training part.
        precision: ``"32"``, or mixed ``"bf16"`` or ``"16"`` (the last needs a CUDA device).
        workers: Processes that prepare pictures; 0 prepares them in the main process.
        early_stopping_patience: Epochs without a better validation success before training ends;
            null never ends it.
        checkpoint_minutes: Minutes after which the state is also saved inside an epoch.
        device: ``"auto"`` takes a CUDA device where there is one.
    """

    epochs: Annotated[int, Field(ge=0)] = 40
    batch_size: Positive = 8
    batches_per_epoch: Positive | None = None
    precision: Annotated[Literal["32", "bf16", "16"], BeforeValidator(_as_text)] = "32"
    workers: Annotated[int, Field(ge=0, le=256)] = 0
    early_stopping_patience: Positive | None = None
    checkpoint_minutes: Annotated[float, Field(ge=0)] = 5.0
    device: Literal["auto", "cpu", "cuda"] = "auto"


class Experiment(_Section):
    """Everything that decides a training run; see the sections.

    Attributes:
        name: Name of the run, for the log and the card.
        seed: Seed of the weights, the order and the augmentation.
        network: See `NetworkSection`.
        tasks: See `TasksSection`.
        data: See `DataSection`.
        maps: See `MapsSection`.
        loss: See `LossSection`.
        optimiser: See `OptimiserSection`.
        schedule: See `ScheduleSection`.
        training: See `TrainingSection`.
    """

    name: Annotated[str, Field(min_length=1)] = "graspmap"
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    network: NetworkSection = NetworkSection()
    tasks: TasksSection = TasksSection()
    data: DataSection
    maps: MapsSection = MapsSection()
    loss: LossSection = LossSection()
    optimiser: OptimiserSection = OptimiserSection()
    schedule: ScheduleSection = ScheduleSection()
    training: TrainingSection = TrainingSection()

    def flat(self) -> dict[str, Any]:
        """Every value by its dotted key, for example ``{"training.epochs": 40, ...}``."""
        return dict(_flatten(self.model_dump(mode="json")))

    def to_yaml(self) -> str:
        """The experiment as YAML text that `read_experiment` reads back to an equal value."""
        return yaml.safe_dump(self.model_dump(mode="json"), sort_keys=False, allow_unicode=True)


def _flatten(values: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in values.items():
        # An empty section is something else than none: it stands for itself.
        if isinstance(value, dict) and value:
            yield from _flatten(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value
