"""The recipe on the command line: ``python -m detden_lite STAGE --task hopper --algo td3 --scale lite``."""

import argparse
import sys
from collections.abc import Callable
from pathlib import Path

from detden_lite import (
    ablations,
    adversaries,
    barrier,
    curve,
    durations,
    evaluation,
    gallery,
    own,
    stages,
    study,
    sweeps,
    tables,
)
from detden_lite.artifacts import ArtifactError
from detden_lite.runs import DATASETS, MAIN, VARIANTS, Run
from detden_lite.scales import ALGORITHMS, SCALES
from detden_lite.tasks import NAMES


def parser() -> argparse.ArgumentParser:
    """The command line."""
    top = argparse.ArgumentParser(
        prog="python -m detden_lite",
        description="Train, attack and defend a victim, stage by stage. A stage makes what is missing: after an "
        "interruption, run it again and it goes on.",
    )
    victim, where = argparse.ArgumentParser(add_help=False), argparse.ArgumentParser(add_help=False)
    victim.add_argument("--task", choices=NAMES, default="hopper", help="default: %(default)s")
    victim.add_argument(
        "--algo", choices=ALGORITHMS, default="td3", help="the victim's algorithm; default: %(default)s"
    )
    where.add_argument(
        "--scale", choices=SCALES, default="tiny",
        help="seconds for a try, hours for what is shipped, days for the paper's sizes; default: %(default)s",
    )  # fmt: skip
    where.add_argument("--root", type=Path, help="folder of the run; default: runs/SCALE")
    stage = top.add_subparsers(dest="stage", required=True, metavar="STAGE")

    def add(name: str, function: Callable, text: str, parents=(victim, where)) -> argparse.ArgumentParser:
        added = stage.add_parser(name, parents=parents, help=text, description=text)
        added.set_defaults(function=function)
        return added

    add("victim", stages.train_victim, "train one seed of the victim").add_argument("--seed", type=int, default=0)
    add("select", stages.select_victim, "choose the best snapshot of all seeds, and evaluate it")
    add("qfunction", stages.learn_q, "learn the Q-function that a PPO victim lacks")
    for name, function, text in (
        ("collect", stages.collect, "collect D_normal, and held-out episodes for calibration"),
        ("augment", stages.augment, "make D_adv from D_normal, offline, with both attacks"),
        ("detector", stages.train_detector, "train the detector and calibrate its threshold"),
    ):
        add(name, function, text).add_argument(
            "--data", choices=DATASETS, default="diverse", help="exploration in D_normal; default: %(default)s"
        )
    add("denoiser", stages.train_denoiser, "train a denoiser").add_argument(
        "--variant", choices=VARIANTS, default=MAIN, help="default: %(default)s"
    )
    add("baselines", ablations.fit_baselines, "fit what the GRU-VAEs have to beat")
    add("threshold", ablations.tune_threshold, "tune C_anomaly as the paper does, on attacked episodes")
    add("timing", stages.tune_timing, "tune when the attacker strikes")
    member = add("adversary", adversaries.train_member, "train a member of the grid of adversaries")
    member.add_argument("--member", type=int, default=0, help="its place in the grid; default: %(default)s")
    chosen = add("choose", adversaries.choose, "choose the adversary that leaves the victim the least")
    for one in (member, chosen):
        one.add_argument("--defended", action="store_true", help="the victim has its main defence")
    add("linear", adversaries.search_linear, "search for a linear adversary")
    evaluate = add("evaluate", evaluation.evaluate, "run every cell of the tables")
    evaluate.add_argument(
        "--defenses", nargs="+", choices=["none", *VARIANTS, *ablations.ASSEMBLED],
        default=["none", MAIN],
        help="none is the bare victim; default: %(default)s",
    )  # fmt: skip
    evaluate.add_argument(
        "--attacks", nargs="+", choices=["none", *study.ATTACKS], default=["none", *study.ATTACKS],
        help="default: all of them",
    )  # fmt: skip
    add("ablate", evaluation.ablate, "run the cells of ablations, baselines and ceilings")
    add("explain", evaluation.explain, "run the cells that tell which part of the main defence falls short")
    add("defend", own.defend_victim, "defend the victim in one call, and evaluate it with the defence and without")
    add("adapt", evaluation.adapt, "run the cells of the attacks that know the defence").add_argument(
        "--defenses", nargs="+", choices=VARIANTS, default=[MAIN], help="default: %(default)s"
    )
    add("barrier", barrier.barrier, "measure what the noise of the latents costs an attacker").add_argument(
        "--variants", nargs="+", choices=VARIANTS, default=list(barrier.VARIANTS),
        help="the defences to look at; default: %(default)s",
    )  # fmt: skip
    add("curve", curve.curve, "measure both sides of the appendix's bound along a denoiser's training").add_argument(
        "--variant", choices=VARIANTS, default="residual", help="default: %(default)s"
    )
    add("epsilon", sweeps.epsilon, "attack at several sizes of the ball")
    add("planning", sweeps.planning, "run the enchanting attack with several planners")
    add("look", gallery.look, "record and film an episode, attacked and not (needs a GL driver)").add_argument(
        "--variant", choices=VARIANTS, default=MAIN, help="default: %(default)s"
    )
    add("portrait", gallery.portrait, "film a clean episode of the victim (needs a GL driver)")
    shown = add("gallery", gallery.gallery, "film and record an episode under each attack (needs a GL driver)")
    shown.add_argument(
        "--attacks", nargs="+", choices=study.ATTACKS, default=list(study.FOUR), help="default: %(default)s"
    )  # fmt: skip
    shown.add_argument("--variant", choices=VARIANTS, default=MAIN, help="default: %(default)s")
    add("slip", gallery.slip, "record an episode under an attack that rings no alarm (needs a GL driver)")
    add("publish", stages.publish, "copy what is shipped into data/")
    add("table", tables.write, "gather the records of all victims in one table", parents=[where])
    took = add("durations", durations.show, "print how long each stage takes", parents=[where])
    took.add_argument("--store", action="store_true", help="measure it in the run first, and store it in data/")
    took.add_argument("--trainings", action="store_true", help="measure how fast victims train, and store it in data/")
    return top


def main(argv: list[str] | None = None) -> None:
    """Run one stage; what it refuses, or the disk does, becomes one line on stderr and the exit status 1."""
    args = parser().parse_args(argv)
    try:
        run_stage(args)
    except (ValueError, OSError, ArtifactError) as error:
        sys.exit(f"error: {error}")


def run_stage(args: argparse.Namespace) -> None:
    """Run the stage that was parsed; the options that are its own are its function's arguments."""
    options = vars(args).copy()
    function, scale, root, _ = (options.pop(key) for key in ("function", "scale", "root", "stage"))
    root = root or Path("runs") / scale
    if "task" in options:
        function(Run.of(root, options.pop("task"), options.pop("algo"), scale), **options)
    else:
        function(root, **options)


if __name__ == "__main__":
    main()
