"""``graspmap gripper train``: a detector for a gripper of one's own, and what it gains."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from graspmap.cli.frame import output_file, output_folder, parse, write_json
from graspmap.cli.gripper_job import WEIGHTS_FILE, Job, TrainForGripper, claim, prepare
from graspmap.errors import FileError

if TYPE_CHECKING:
    from graspmap.evaluation.compare import Comparison


def train(argv: Sequence[str]) -> None:
    """Run ``graspmap gripper train``."""
    flags = parse(TrainForGripper, argv, "graspmap gripper train")
    job = prepare(flags, shlex.join(["graspmap", "gripper", "train", *argv]))
    output_file(flags.json, "--json", keep=[Path(flags.gripper), job.compared])
    output_folder(flags.out, "--out")
    from graspmap.files import locked

    with locked(flags.out, "graspmap gripper train"):
        claim(job)
        _make_data(job)
        _train(job)
        _calibrate(job)
        folders = _evaluate(job)
        comparison = _compare(job, folders)
        write_json(_conclude(job, folders, comparison), flags.json)


def _make_data(job: Job) -> None:
    from graspmap.cli.generate import make_data_set

    for name, plan in job.plans.items():
        job.tell(f"1 of 4, {name}: {plan.scenes} scenes for gripper {job.gripper.name}")
        make_data_set(plan, job.part(name), workers=job.flags.workers, tell=job.tell)


def _train(job: Job) -> None:
    from graspmap.cli.train import train_network

    values = job.experiment
    job.tell(
        f"2 of 4, training: {values.network.name} on {values.network.channels}, "
        f"{values.training.epochs} epoch" + "s" * (values.training.epochs != 1)
    )
    train_network(values, job.trained, job.command, job.tell)


def _calibrate(job: Job) -> None:
    from graspmap.cli.trial_flags import TrialFlags
    from graspmap.cli.weights_calibrate import Calibrate, calibrate_weights

    job.tell("3 of 4, calibration: how often does a grasp of which quality hold?")
    if _is_calibrated(job):
        job.tell(f"  {job.weights} is finished")
        return
    calibrate_weights(
        Calibrate(
            weights=job.trained / WEIGHTS_FILE,
            data=job.source("validation"),
            depth=job.experiment.data.depth,
            out=job.weights,
            seed=job.flags.seed,
            device=job.device,
            json=job.told,
            trial=TrialFlags(workers=job.flags.workers),
        )
    )


def _is_calibrated(job: Job) -> bool:
    """Whether the weights are those of the training, calibrated on these validation scenes."""
    from graspmap.data import read_scenes
    from graspmap.data.fingerprint import data_hash
    from graspmap.inference import load_weights, weights_hash

    if not job.weights.is_file():
        return False
    network, card = load_weights(job.weights)
    if card.calibration is None:
        return False
    plain = weights_hash(network, card.model_copy(update={"calibration": None}))
    return plain == weights_hash(
        *load_weights(job.trained / WEIGHTS_FILE)
    ) and card.calibration.data_hash == data_hash(read_scenes(job.source("validation")))


def _evaluate(job: Job) -> dict[str, Path]:
    """The folders of the reports: ``own``, and ``compared`` where there is something to compare."""
    from graspmap.cli.evaluate import Evaluate, measure
    from graspmap.cli.trial_flags import TrialFlags

    root = job.flags.out / "evaluation"
    todo = {"own": (job.weights, root / "own")}
    if job.compared is not None:
        todo["compared"] = (job.compared, root / f"compared-{job.compared.stem}")
    for name, (weights, folder) in todo.items():
        job.tell(f"4 of 4, evaluation: {weights} with gripper {job.gripper.name}")
        if _is_evaluated(job, weights, folder):
            job.tell(f"  {folder / 'report.html'} is finished")
            continue
        measure(
            Evaluate(
                data=job.source("test"),
                weights=weights,
                trials=True,
                depth=job.experiment.data.depth,
                cluster="scene" if job.plans["test"].views == 1 else "object",
                baseline=name == "own",
                seed=job.flags.seed,
                device=job.device,
                out=folder,
                json=job.told,
                trial=TrialFlags(workers=job.flags.workers),
            ),
            job.command,
        )
    return {name: folder for name, (_, folder) in todo.items()}


def _is_evaluated(job: Job, weights: Path, folder: Path) -> bool:
    """Whether a report is of these weights and of these test scenes."""
    from graspmap.data import read_scenes
    from graspmap.data.fingerprint import data_hash
    from graspmap.evaluation.cards import evaluation_card
    from graspmap.inference import load_weights, weights_hash

    if not (folder / "report.html").is_file():
        return False
    try:
        card = evaluation_card(folder, weights_hash(*load_weights(weights)))
    except FileError:
        return False
    return card.data_hash == data_hash(read_scenes(job.source("test")))


def _compare(job: Job, folders: Mapping[str, Path]) -> Comparison | None:
    from graspmap.cli.compare import Compare, compare

    if "compared" not in folders:
        return None
    flags = Compare(
        folders=(folders["own"], folders["compared"]),
        seed=job.flags.seed,
        out=job.flags.out / "comparison",
        json=job.told,
    )
    return compare(flags)


def _conclude(
    job: Job, folders: Mapping[str, Path], comparison: Comparison | None
) -> dict[str, Any]:
    """The last words, and the same for machines."""
    from graspmap.evaluation.compare import best_trials
    from graspmap.evaluation.run_folder import read_run_folder
    from graspmap.inference import shipped_weights

    names = {job.weights: "yours", job.compared: str(job.compared)}
    names |= {path: f"{name}, which ship" for name, path in shipped_weights().items()}
    found: dict[str, Any] = {}
    job.tell(f"gripper {job.gripper.name}, {job.plans['test'].scenes} test scenes:")
    for name, folder in folders.items():
        run = read_run_folder(folder)
        score = best_trials(run, by_object=run.cluster == "object")
        assert score is not None  # the evaluation made trials
        low, high = score.interval
        weights = job.weights if name == "own" else job.compared
        job.tell(
            f"  {names[weights]}: the best grasp held in {score.held} of {score.trials} trials, "
            f"{score.success:.1%} (95 % interval {low:.1%} to {high:.1%})"
        )
        found[name] = {
            "weights": str(weights),
            "report": str(folder / "report.html"),
            "trials": score.trials,
            "held": score.held,
            "success": score.success,
            "interval": [low, high],
        }
    if comparison is not None:
        found["difference"] = _difference(job, comparison)
    line = shlex.join(_detect_words(job))
    job.tell(f"weights: {job.weights}")
    job.tell(f"use them: {line}")
    return {"gripper": job.gripper.name, "weights": str(job.weights), "detect": line, **found}


def _difference(job: Job, comparison: Comparison) -> dict[str, Any]:
    (pair,) = (pair for pair in comparison.pairs if pair.measure == "held")
    low, high = pair.result.interval
    verdict = "not decided by so few scenes: it may be chance"
    if low > 0:
        verdict = "yours hold more often"
    elif high < 0:
        verdict = "yours hold less often"
    job.tell(
        f"  difference on the same scenes: {100 * pair.result.difference:+.1f} points "
        f"(95 % interval {100 * low:+.1f} to {100 * high:+.1f}): {verdict}"
    )
    page = job.flags.out / "comparison" / "comparison.html"
    job.tell(f"  see {page}")
    return {**pair.to_dict(), "page": str(page)}


def _detect_words(job: Job) -> list[str]:
    pictures = ["--depth", "depth.tiff", "--camera", "camera.json"]
    if job.experiment.network.channels == "rgbd":
        pictures = ["--rgb", "colour.png", *pictures]
    return [
        *("graspmap", "detect", "--weights", str(job.weights)),
        *("--gripper", job.flags.gripper, *pictures, "--overlay", "grasps.png"),
    ]
