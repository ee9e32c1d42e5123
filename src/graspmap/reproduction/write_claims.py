"""Judged claims as Markdown, rows for CSV, and JSON."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Sequence
from typing import Any

from graspmap.reproduction.claims import RULE, JudgedClaim, TestedPair
from graspmap.reproduction.measures import MEASURES
from graspmap.reproduction.table_file import ByScene


def claims_to_markdown(judged: Sequence[JudgedClaim]) -> list[str]:
    """All claims in one table, the rule, and each claim with its numbers: lines of Markdown."""
    lines = ["## Verdicts", "", "| Claim | said in | verdict | the same in trials |",
             "| --- | --- | --- | --- |"]  # fmt: skip
    for one in judged:
        where = "correlation" if one.claim.foretells else MEASURES[one.claim.by].title
        trials = one.in_trials or "-"
        lines.append(f"| {one.claim.name} | {where} | **{one.verdict}** | {trials} |")
    lines += ["", "The rule:", *(f"- {line}" for line in RULE), ""]
    for one in judged:
        claim = one.claim
        lines += [f"## {claim.name}: {one.verdict}", "", claim.statement, "",
                  f"{claim.source}: {claim.printed}.", ""]  # fmt: skip
        lines += _correlation(one) if claim.foretells else _pairs(one)
    return lines


def _pairs(one: JudgedClaim) -> list[str]:
    tested = [pair for pair in one.pairs if pair.found]
    lines = []
    if tested:
        lines += ["| First | second | measure | first | second | difference (95 % interval) "
                  "| of each seed | verdict |",
                  "| --- | --- | --- | ---: | ---: | ---: | ---: | --- |"]  # fmt: skip
        lines += [_pair_line(one, pair, name) for pair in tested for name in pair.found]
        found = tested[0].found[one.claim.by]
        lines += ["", f"{found.scenes.scenes} scenes of {found.scenes.groups} objects, "
                      f"{found.seeds} seeds."]  # fmt: skip
    lines += [f"- Not tested: {p.pair.better} against {p.pair.than}: {p.why}."
              for p in one.pairs if not p.found]  # fmt: skip
    return [*lines, ""]


def _pair_line(one: JudgedClaim, tested: TestedPair, name: ByScene) -> str:
    found = tested.found[name]
    low, high = (100 * end for end in found.interval)
    title, said = MEASURES[name].title, tested.verdicts[name]
    if name == one.claim.by:
        title, said = f"**{title}**", f"**{said}**"
    seeds = ", ".join(f"{100 * value:+.1f}" for value in found.by_seed)
    cells = (
        tested.pair.better,
        tested.pair.than,
        title,
        f"{100 * found.scenes.mean_a:.1f}",
        f"{100 * found.scenes.mean_b:.1f}",
        f"{100 * found.difference:+.1f} ({low:+.1f} to {high:+.1f})",
        seeds,
        said,
    )
    return f"| {' | '.join(cells)} |"


def _correlation(one: JudgedClaim) -> list[str]:
    if one.gain is None or one.claim.foretells is None:
        return ["Too few rows have all their seeds.", ""]
    lines = ["| Measure | rows | Pearson's r with SGT (95 % interval) | p | Spearman's |",
             "| --- | ---: | ---: | ---: | ---: |"]  # fmt: skip
    for name, found in one.correlations.items():
        r, p, rank = found.pearson, found.pearson_p, found.spearman
        said = "the same for all"
        if r is not None and found.pearson_interval is not None:
            said = f"{r:.3f} ({found.pearson_interval[0]:.3f} to {found.pearson_interval[1]:.3f})"
        numbers = ("-" if v is None else f"{v:.3f}" for v in (p, rank))
        lines.append(
            f"| {MEASURES[name].title} | {found.models} | {said} | {' | '.join(numbers)} |"
        )
    first, second = (MEASURES[name].title for name in one.claim.foretells)
    if one.gain.difference is not None and one.gain.interval is not None:
        low, high = one.gain.interval
        lines += ["", f"{first} minus {second}: {one.gain.difference:+.3f} ({low:+.3f} to "
                      f"{high:+.3f})."]  # fmt: skip
    return [*lines, ""]


def claims_to_csv(judged: Sequence[JudgedClaim]) -> str:
    """One line for each pair and measure; shares."""
    heads = ("claim", "first", "second", "measure", "decides", "mean first", "mean second",
             "difference", "low", "high", "scenes", "objects", "seeds", "verdict")  # fmt: skip
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(heads)
    writer.writerows(_csv_rows(judged))
    return text.getvalue()


def _csv_rows(judged: Sequence[JudgedClaim]) -> Iterator[list[Any]]:
    for one in judged:
        for tested in one.pairs:
            names = (one.claim.name, tested.pair.better, tested.pair.than)
            for measure, found in tested.found.items():
                over = found.scenes
                numbers = (over.mean_a, over.mean_b, found.difference, *found.interval)
                yield [*names, measure, int(measure == one.claim.by), *map(repr, numbers),
                       over.scenes, over.groups, found.seeds, tested.verdicts[measure]]  # fmt: skip


def claim_to_dict(one: JudgedClaim) -> dict[str, Any]:
    """A claim for JSON."""
    claim = one.claim
    return {
        "name": claim.name,
        "statement": claim.statement,
        "source": claim.source,
        "printed": claim.printed,
        "by": "correlation" if claim.foretells else claim.by,
        "expect": claim.expect,
        "verdict": one.verdict,
        "in_trials": one.in_trials,
        "pairs": [
            {
                "first": tested.pair.better,
                "second": tested.pair.than,
                "why_not_tested": tested.why or None,
                "measures": {
                    name: {**found.to_dict(), "verdict": tested.verdicts[name]}
                    for name, found in tested.found.items()
                },
            }
            for tested in one.pairs
        ],
        "gain": None if one.gain is None else one.gain.to_dict(),
        "correlations": {name: found.to_dict() for name, found in one.correlations.items()},
    }
