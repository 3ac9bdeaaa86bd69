"""The recipe on the command line: ``detden STAGE --task hopper --algo td3 --scale lite``."""

import argparse
import sys
import textwrap
from importlib import import_module
from pathlib import Path

from detden_lite import __version__
from detden_lite.core.files import ArtifactError
from detden_lite.core.tasks import ALGORITHMS, ONLINE, SCALES, TASK_NAMES
from detden_lite.recipe.stage_list import GROUPS, STAGES, Option


def parser() -> argparse.ArgumentParser:
    """The parser of the command line: a subcommand for each stage."""
    top = argparse.ArgumentParser(
        prog="detden",
        description="Train, attack and defend a victim, stage by stage. A stage makes what is missing: after an "
        "interruption, run it again to resume it.",
        epilog=_listing(),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    top.add_argument("--version", action="version", version=f"detden {__version__}")
    victim, where = argparse.ArgumentParser(add_help=False), argparse.ArgumentParser(add_help=False)
    victim.add_argument("--task", choices=TASK_NAMES, default="hopper", help="default: %(default)s")
    victim.add_argument(
        "--algo", choices=(*ALGORITHMS, *ONLINE), default="td3", help="the victim's algorithm; default: %(default)s"
    )
    where.add_argument(
        "--scale", choices=SCALES, default="tiny",
        help="seconds for a try, hours for what is shipped, days for the paper's sizes; default: %(default)s",
    )  # fmt: skip
    where.add_argument("--root", type=Path, help="folder of the run; default: runs/SCALE")
    stages = top.add_subparsers(dest="stage", required=True, metavar="STAGE")
    for stage in STAGES.values():
        added = stages.add_parser(
            stage.name, parents=(victim, where) if stage.row else (where,), description=stage.text
        )
        for option in stage.options:
            _add(added, option)
    return top


def _add(stage: argparse.ArgumentParser, option: Option) -> None:
    text = "; ".join([*filter(None, [option.text]), "default: %(default)s"])
    match option.default:
        case bool():
            stage.add_argument(option.flag, action="store_true", help=option.text)
        case int():
            stage.add_argument(option.flag, type=_count, default=option.default, help=text, metavar="N")
        case str():
            stage.add_argument(option.flag, choices=option.choices, default=option.default, help=text)
        case tuple():
            text = f"{option.text}, one or more of: {', '.join(option.choices)}; default: {' '.join(option.default)}"
            stage.add_argument(
                option.flag, choices=option.choices, default=option.default, nargs="+", help=text, metavar="NAME"
            )


def _count(text: str) -> int:
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"{text!r} is no whole number of at least 0")
    return int(text)


def _listing() -> str:
    """All stages, grouped by what they are for."""
    lines = []
    for group, title in GROUPS.items():
        lines.append(f"{title}:")
        for stage in STAGES.values():
            if stage.group == group:
                text = textwrap.wrap(stage.text, 66)
                lines += [f"  {stage.name:<10}  {text[0]}", *(f"{'':<14}{more}" for more in text[1:])]
    return "\n".join([*lines, "", "detden STAGE --help tells a stage's options."])


def main(argv: list[str] | None = None) -> None:
    """Run one stage.

    An error of a stage or of the disk becomes one line on stderr and the exit status 1; an unknown stage or option
    exits with 2 and lists the choices.
    """
    args = parser().parse_args(argv)
    try:
        run_stage(args)
    except (ValueError, OSError, ArtifactError) as error:
        sys.exit(f"error: {error}")


def run_stage(args: argparse.Namespace) -> None:
    """Run the stage that was parsed; the options that are its own are its function's arguments."""
    options = vars(args).copy()
    name, scale, root = (options.pop(key) for key in ("stage", "scale", "root"))
    module, function = STAGES[name].function.split(":")
    run = getattr(import_module(f"detden_lite.{module}"), function)
    root = root or Path("runs") / scale
    if not STAGES[name].row:
        run(root, **options)
        return
    from detden_lite.recipe.run import Run  # which loads torch: after the arguments were found to be right

    run(Run.of(root, options.pop("task"), options.pop("algo"), scale), **options)
