"""``graspmap reproduce``: the tables and figures of the thesis made again, its claims tested."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from graspmap.cli.frame import (
    UsageError,
    option,
    output_file,
    output_folder,
    parse_known,
    teller,
    write_json,
)
from graspmap.cli.progress import progress

if TYPE_CHECKING:
    from graspmap.reproduction import Crew, Estimate, Filled, Outcome, Plan

_LOG = logging.getLogger(__name__)


@dataclass(frozen=True)
class Reproduce:
    """Make a table or figure of the thesis again, on your data, or put its claims to the test.

    Examples:
      graspmap reproduce                      the tables and figures that there are
      graspmap reproduce table-5.1 --data jacquard:DIR --scale 0.01 --dry-run
      graspmap reproduce table-5.1 --data jacquard:DIR --scale 0.01
      graspmap reproduce table-3.1 --data cornell:DIR --rows "MTG-CNN c*" --folds 1/5
      graspmap reproduce table-4.3 --data cornell:DIR --test-data jacquard:OTHER
      graspmap reproduce fig-4.8 --data jacquard:DIR --data.size 96 --training.epochs 5
      graspmap reproduce claims --data DIR --scale 0.1

    A table is expanded to its runs: one for each row, column and fold. Each is trained, chosen on
    its validation part and tested once. Runs that several rows or tables share are made once; what
    is there is never made again. Stopped at any moment (Ctrl-C, kill, power), the same command goes
    on; several at once with the same --out, on one machine or many, share the work.
    OUT/NAME/ then holds NAME.md, NAME.csv and NAME.json (a figure has a picture, too), OUT/runs/
    every run. The full training of the thesis takes days on a GPU: --scale makes it smaller, and
    the table says so. Any other key of an experiment can be set for all runs: --data.size 96,
    --data.depth stereo, --data.split.by image, --data.split.limit_objects 50, --training.workers 2.

    claims takes the folder of a recipe's parts (graspmap generate --recipe graspmap-v1 --out DIR).
    Each claim of the thesis becomes pairs of networks, trained with several seeds and compared on
    the same test scenes, by rectangles and by trials, with intervals and a verdict.
    """

    name: Annotated[tyro.conf.Positional[str], option("NAME")] = ""
    """table-3.1 to table-5.3, fig-4.8, fig-5.6, or claims; without it they are listed."""
    data: Annotated[str | None, option("KIND:DIR", "needed, but for tables of times")] = None
    """Data to train and test on: jacquard:DIR, cornell:DIR, or what `graspmap generate` made. For
    claims the folder of a recipe, with the parts train, validation and test-..."""
    test_data: Annotated[str | None, option("KIND:DIR", "table-4.3 only")] = None
    """Other data to test on."""
    scale: Annotated[float, option("S", "default: 1, as published")] = 1.0
    """Share of the published training steps: epochs and batches an epoch shrink by its square root
    each, to 1 at least. The input size stays: --data.size makes it smaller."""
    folds: Annotated[str | None, option("K or N/K", "default: as the table says")] = None
    """Folds of the cross-validation: K runs all of K, N/K the first N of K. Each holds 1/K of the
    objects out, half to choose the epoch, half to test."""
    rows: Annotated[str | None, option("PATTERN", "default: all")] = None
    """Only rows whose labels contain this, or match it: "U-Net", "*RGB / MSE*"."""
    seed: Annotated[int, option("N", "default: 0")] = 0
    """Seed of weights, order and folds; the same seed gives the same table."""
    seeds: Annotated[int | None, option("N", "claims only, default: 3")] = None
    """How many seeds each network is trained with, from --seed on: at least 2."""
    large: bool = False
    """Claims only: also train GR-ConvNet and U-Net, which takes a GPU."""
    workers: Annotated[int | None, option("W", "default: cores / threads, or GPUs")] = None
    """Runs at once, each in a process of its own."""
    threads: Annotated[int | None, option("T", "default: 1 on a CPU")] = None
    """Threads of each run. On a CPU the last bits of the result depend on it, on --workers not."""
    devices: Annotated[str, option("auto|cpu|0,1,...", "default: auto")] = "auto"
    """Where: all GPUs or else the CPU, the CPU, or GPUs by number, one for each worker in turn."""
    out: Annotated[Path, option("DIR", "default: reproduction")] = Path("reproduction")
    """Folder of tables and runs; use one for all tables, they share runs."""
    dry_run: bool = False
    """Only say which runs there would be, with parameters and a rough time; nothing is written."""
    json: Annotated[Path | None, option("F")] = None
    """Write the table (of a dry run: the runs) as JSON to this file, - for standard output."""


def run(argv: Sequence[str]) -> int:
    """Run ``graspmap reproduce``."""
    flags, rest = parse_known(Reproduce, argv, "graspmap reproduce")
    if rest and not rest[0].startswith("--"):
        raise UsageError("graspmap reproduce", f"{rest[0]!r} belongs to no flag")
    if not flags.name:
        if len(argv) > (2 if flags.json is not None else 0):
            raise UsageError("graspmap reproduce", "no table is named")
        return _list(flags)
    from graspmap.config import parse_overrides
    from graspmap.reproduction import Request, choose_crew, make_plan

    request = Request(
        name=flags.name,
        data=flags.data,
        test_data=flags.test_data,
        folds=flags.folds,
        scale=flags.scale,
        rows=flags.rows,
        seed=flags.seed,
        seeds=flags.seeds,
        large=flags.large,
        changes=parse_overrides(rest),
    )
    plan = make_plan(request)
    crew = choose_crew(flags.workers, flags.threads, flags.devices)
    output_file(flags.json, "--json")
    _warn(plan)
    if flags.dry_run:
        return _dry_run(flags, plan, crew)
    output_folder(flags.out / "runs", "--out")
    filled, outcome = _fill(flags, plan, crew)
    return _report(flags, filled, outcome)


def _list(flags: Reproduce) -> int:
    """The tables and figures, a line each."""
    from graspmap.reproduction import read_table, table_names

    tables = {name: read_table(name) for name in table_names()}
    tell = teller(flags.json)
    for name, table in tables.items():
        kinds = " and ".join(kind for kind in (table.data, table.test_data) if kind)
        tell(f"{name}  {table.title}{f' ({kinds})' if kinds else ''}")
    tell("\nstart with: graspmap reproduce NAME --data KIND:DIR --scale 0.01 --dry-run")
    write_json({n: {"title": t.title, "data": t.data} for n, t in tables.items()}, flags.json)
    return 0


def _warn(plan: Plan) -> None:
    """Say before anything runs what the data cannot give."""
    from graspmap.reproduction.measures import MEASURES

    for title, why in plan.left_out:
        _LOG.warning("row left out: %s: %s", title, why)
    for name, why in plan.unmeasured.items():
        if name in plan.measures:
            _LOG.warning("not measured: %s: %s", MEASURES[name].title, why)
    if plan.table.kind == "times" and plan.request.data is not None:
        _LOG.warning("%s needs no data: its networks are timed untrained", plan.request.name)


def _dry_run(flags: Reproduce, plan: Plan, crew: Crew) -> int:
    from graspmap.reproduction import estimate
    from graspmap.reproduction.words import duration

    tell = teller(flags.json)
    if not plan.runs:
        tell(f"{plan.request.name}: no runs, {len(plan.experiments)} networks are timed")
        write_json({"table": plan.request.name, "runs": []}, flags.json)
        return 0
    _LOG.info("timing one training step of each network")
    costs = estimate(plan, crew.devices[0], crew.threads)
    for run in plan.runs:
        cost, training = costs[run.id], run.experiment.training
        tell(
            f"{run.id}  {cost.parameters:>11,} parameters  {training.epochs} epochs, "
            f"{cost.steps:,} steps of {training.batch_size}  about {duration(cost.seconds)}  "
            f"{run.title}"
        )
    total = sum(cost.seconds for cost in costs.values()) / min(crew.workers, len(plan.runs))
    places = sum(len(names) for names in plan.cells.values())
    shared = f", {places - len(plan.runs)} more are shared" if places > len(plan.runs) else ""
    there = _there(flags, plan)
    done = f"; {there} of them are in {flags.out} already" if there else ""
    tell(
        f"{len(plan.runs)} runs{shared}; about {duration(total)} with {crew.workers} workers of "
        f"{crew.threads} threads on {', '.join(crew.devices)}, reading and trials aside{done}"
    )
    write_json(_costs(plan, costs, crew, total), flags.json)
    return 0


def _there(flags: Reproduce, plan: Plan) -> int:
    from graspmap.reproduction.work import read_result

    return sum(read_result(flags.out / "runs", run) is not None for run in plan.runs)


def _costs(plan: Plan, costs: Mapping[str, Estimate], crew: Crew, total: float) -> dict[str, Any]:
    runs = [
        {
            "run": run.id,
            "title": run.title,
            "network": run.experiment.network.name,
            "parameters": costs[run.id].parameters,
            "epochs": run.experiment.training.epochs,
            "steps": costs[run.id].steps,
            "seconds": costs[run.id].seconds,
        }
        for run in plan.runs
    ]
    return {
        "table": plan.request.name,
        "runs": runs,
        "workers": crew.workers,
        "threads": crew.threads,
        "devices": list(crew.devices),
        "seconds": total,
        "left_out": [{"row": row, "why": why} for row, why in plan.left_out],
    }


def _fill(flags: Reproduce, plan: Plan, crew: Crew) -> tuple[Filled, Outcome]:
    from graspmap.reproduction import conduct, fill, judge

    if plan.table.kind != "times":
        runs = flags.out / "runs"
        outcome = conduct(plan, runs, crew, progress)
        claims = judge(plan, outcome.results, runs)
        return fill(plan, outcome.results, outcome.failures, claims=claims), outcome
    from graspmap.reproduction import Outcome, time_detection

    device = "cpu" if crew.devices == ("cpu",) else f"cuda:{crew.devices[0]}"
    timed = {}
    with progress("timing networks") as update:
        for done, ((row, _), experiment) in enumerate(plan.experiments.items(), start=1):
            timed[row] = time_detection(experiment, device)
            update(done, len(plan.experiments))
    return fill(plan, {}, timed=timed), Outcome()


def _report(flags: Reproduce, filled: Filled, outcome: Outcome) -> int:
    from graspmap.reproduction import to_dict, to_markdown, write_table

    files = write_table(filled, flags.out / filled.plan.request.name)
    tell = teller(flags.json)
    tell(to_markdown(filled))
    tell("written: " + ", ".join(map(str, files)))
    write_json(to_dict(filled), flags.json)
    if outcome.failures:
        _LOG.error(
            "%d of %d runs failed; the same command tries them again",
            len(outcome.failures),
            len(filled.plan.runs),
        )
        return 1
    return 0
