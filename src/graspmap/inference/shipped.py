"""Weights that ship with graspmap: by name, and the best for the pictures that there are."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

from graspmap.data.images import Channels, channel_count
from graspmap.errors import InvalidInputError
from graspmap.files import shipped_or_path
from graspmap.inference.weights import SUFFIX, read_card

_FOLDER = Path(__file__).with_name("shipped")


def shipped_weights() -> dict[str, Path]:
    """The weights files that ship with graspmap, by name in alphabetical order."""
    return {path.stem: path for path in sorted(_FOLDER.glob(f"*{SUFFIX}"))}


def weights_path(name_or_path: Path | str) -> Path:
    """The file of shipped weights, or of a user's; see `graspmap.files.shipped_or_path`.

    Raises:
        UnknownNameError: It is no path, and no shipped weights have this name.
    """
    return shipped_or_path(name_or_path, shipped_weights(), what="weights", own=f"a {SUFFIX} file")


def best_shipped(channels: Collection[Channels]) -> Path | None:
    """The shipped weights of the highest trial success; of equals, those that see most.

    Args:
        channels: What they may look at: ``depth``, ``rgb``, ``rgbd``.

    Returns:
        Their file; None where none look at these.
    """
    cards = {path: read_card(path) for path in shipped_weights().values()}
    found = {
        path: (card.trial_success or 0.0, channel_count(card.channels))
        for path, card in cards.items()
        if card.channels in channels
    }
    return max(found, key=lambda path: found[path], default=None)


def default_weights(*, has_rgb: bool = True, has_depth: bool = True) -> Path:
    """The best weights that ship for the pictures that there are.

    Of all that need no more than there is, the one whose card says the highest trial success.

    Args:
        has_rgb: Whether there is a colour picture.
        has_depth: Whether there is a depth picture.

    Raises:
        InvalidInputError: None that ships fits them.
    """
    usable: dict[Channels, bool] = {
        "rgbd": has_rgb and has_depth,
        "depth": has_depth,
        "rgb": has_rgb,
    }
    found = best_shipped({channels for channels, there in usable.items() if there})
    if found is not None:
        return found
    pictures = " and ".join(n for n, there in (("colour", has_rgb), ("depth", has_depth)) if there)
    raise InvalidInputError(
        "weights",
        "not given",
        f"a weights file (this graspmap ships none for {pictures or 'no'} pictures): give one with "
        "--weights, make one with graspmap train, or bring others' with graspmap weights import",
    )
