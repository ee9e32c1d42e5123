"""``graspmap compare``: several evaluations side by side."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from graspmap.cli.frame import option, output_file, output_folder, parse, teller, write_json
from graspmap.errors import InvalidInputError

if TYPE_CHECKING:
    from graspmap.evaluation.compare import Comparison

_MEASURES = {"iou": "mean overlap", "held": "held in trials"}


@dataclass(frozen=True)
class Compare:
    """Set evaluations side by side: is one detector better than another, or is it chance?

    Example:
      graspmap compare reports/ggcnn2 reports/unet --out comparison

    Each DIR is what `graspmap evaluate --out` or `graspmap trial --out` wrote, all of one data set
    and one protocol. Any two are compared on the scenes that both have: right or wrong and held or
    not by McNemar's exact test, overlap (and all of them where objects are what is independent) by
    random changes of sign; the interval of the difference is the paired bootstrap's. p values
    that allow for the number of pairs (Holm) stand beside. With four or more that have trials:
    how well overlap foretells them (Pearson, Spearman). Trials must have been made in one way
    (gripper, jaw, shake, perturbation); detectors that saw different depth are told.
    """

    folders: Annotated[tyro.conf.Positional[tuple[Path, ...]], option("DIR")]
    """Folders to compare, two or more."""
    confidence: Annotated[float, option("P", "default: 0.95")] = 0.95
    """Confidence of the intervals."""
    seed: Annotated[int, option("N", "default: 0")] = 0
    """Seed of the intervals."""
    out: Annotated[Path | None, option("DIR")] = None
    """Folder for comparison.html, comparison.csv and comparison.json."""
    json: Annotated[Path | None, option("F")] = None
    """Write the comparison as JSON to this file, - for standard output."""


def run(argv: Sequence[str]) -> int:
    """Run ``graspmap compare``."""
    flags = parse(Compare, argv, "graspmap compare")
    write_json(compare(flags).to_dict(), flags.json)
    return 0


def compare(flags: Compare) -> Comparison:
    """Compare as the flags say, write the page where they ask for one, and tell about it.

    Raises:
        GraspmapError: A flag is out of range, or a folder cannot be used, or is of something else.
    """
    if not 0 < flags.confidence < 1:
        raise InvalidInputError("--confidence", flags.confidence, "above 0 and below 1")
    if flags.seed < 0:
        raise InvalidInputError("--seed", flags.seed, "0 or more")
    if flags.out is not None:
        output_folder(flags.out, "--out")
    output_file(flags.json, "--json")
    from graspmap.evaluation.compare import compare_runs

    comparison = compare_runs(flags.folders, seed=flags.seed, confidence=flags.confidence)
    tell = teller(flags.json)
    _tell(comparison, tell)
    if flags.out is not None:
        from graspmap.evaluation.report.comparison_page import write_comparison

        tell("  written: " + ", ".join(map(str, write_comparison(comparison, flags.out))))
    return comparison


def _tell(comparison: Comparison, tell: Callable[[str], None]) -> None:
    from graspmap.evaluation.compare import best_trials

    width = max(map(len, comparison.runs))
    tell(f"{len(comparison.runs)} evaluations of {next(iter(comparison.runs.values())).data}")
    for note in comparison.notes:
        tell(f"  warning: {note}")
    for name, found in comparison.runs.items():
        parts = [
            f"IoU {t} {share:.1%}" for t, share in (found.summary.get("success") or {}).items()
        ]
        trials = best_trials(found)
        if trials is not None:
            parts.append(f"held {trials.success:.1%}")
        tell(f"  {name:<{width}}  {', '.join(parts)}")
    for pair in comparison.pairs:
        result = pair.result
        low, high = result.interval
        measure = _MEASURES.get(pair.measure, f"right at IoU {comparison.threshold}")
        tell(
            f"  {pair.a} - {pair.b}, {measure}: {result.difference:+.3f} "
            f"({low:+.3f} to {high:+.3f}), p = {result.p_value:.2g}, "
            f"of all pairs {pair.p_adjusted:.2g}, {result.scenes} scenes"
        )
    for name, c in comparison.correlations.items():
        if c.pearson is None or c.spearman is None:
            tell(f"  {name} and trials: the same in all, so no correlation")
        else:
            tell(
                f"  {name} and trials: Pearson {_with_ends(c.pearson, c.pearson_interval)}, "
                f"Spearman {_with_ends(c.spearman, c.spearman_interval)}"
            )


def _with_ends(value: float, ends: tuple[float, float] | None) -> str:
    return f"{value:.2f}" + ("" if ends is None else f" ({ends[0]:.2f} to {ends[1]:.2f})")
