"""The tables of the page for teachers: three paths, what each exercise is for, and the mistakes that checks know."""

import ast
import inspect
import textwrap
from dataclasses import dataclass
from functools import cache
from importlib import import_module

from grade import Exercise, read_course

PURPOSE = {  # what an exercise is for, by its number
    "1.1": "To see that a return belongs to a step, and to meet the recursion that every critic is trained on.",
    "1.2": "To keep the episodes apart on which something is chosen and those on which it is reported.",
    "1.3": "To put an interval on every mean from here on, without assuming a distribution.",
    "1.4": "To think in arrays of episodes that end at different steps, as all later code does.",
    "2.1": "To make the attacker's budget precise: what is allowed, and what happens at the border.",
    "2.2": "To derive the attack's objective from the policy's distribution.",
    "2.3": "To see why a gradient attack starts beside the true observation, takes the sign, and projects.",
    "2.4": "To turn the critic into a clock: strike where the robot has little to expect.",
    "3.1": "To see why a sample can have a gradient.",
    "3.2": "To know what the KL term charges for, and what a free prior leaves free.",
    "3.3": "To set a threshold from clean episodes alone.",
    "3.4": "To read three error rates that each hide one kind of error.",
    "4.1": "To see that adversarial training data need no simulator.",
    "4.2": "To find the bug that trains well: the wrong pair of input and target.",
    "4.3": "To measure an error where it counts, and nowhere else.",
    "4.4": "To join the parts, and to see how broadcasting mixes up episodes and dimensions.",
    "5.1": "To separate what the world is from what the policy is shown.",
    "5.2": "To write the step that planners and searches share.",
    "5.3": "To see an attack as an environment of its own, in which a network can learn.",
    "5.4": "To split an attack into where to push and how.",
    "5.5": "To make the cheapest control: a perturbation that does not change.",
    "5.6": "To see with a detector's eyes, and to know what it cannot see.",
    "6.1": "To refute an inequality with the smallest world that breaks it.",
    "6.2": "To compare a bound with the exact value, and to see where it says nothing.",
    "6.3": "To find the one false step of a proof.",
    "7.1": "To measure a change of action as the policy itself would.",
    "7.2": "To get every sign of a combined loss right.",
    "7.3": "To test whether a robust denoiser still tells the policy anything.",
    "8.1": "To use pairs: episodes that share a start share their luck.",
    "8.2": "To report a worst case without the bias of having chosen it.",
    "8.3": "To see how F1 depends on how often the attacker strikes.",
    "8.4": "To find out which errors of an observation the policy feels.",
    "9.1": "To write the adaptive attacker's term with its right sign.",
    "9.2": "To attack through noise: why randomness alone is no defence.",
    "9.3": "To get around a defence that hides its gradient.",
}


@dataclass(frozen=True)
class Session:
    """A part of a path: what is done, how long it takes, and which exercises belong to it."""

    what: str
    minutes: int
    exercises: str = ""


PATHS = {
    "Four hours": (
        Session("Chapter 1: the victim; returns and intervals", 40, "1.1, 1.3"),
        Session("Chapter 2: budgets, FGSM, the opposite attack", 60, "2.1, 2.3"),
        Session("Break", 15),
        Session("Chapter 3: the detector, without the part on priors", 45, "3.3, 3.4"),
        Session("Chapter 4: offline data, the denoiser, the defence", 45, "4.1, 4.4"),
        Session("Chapter 8: the worst case; a discussion of Where it breaks", 35, "8.2"),
    ),
    "Two days": (
        Session("Day 1. Chapter 1", 60, "1.1 to 1.4"),
        Session("Chapter 2", 90, "2.1 to 2.4"),
        Session("Chapter 3", 105, "3.1 to 3.4"),
        Session("Chapter 4", 90, "4.1 to 4.4"),
        Session("Day 2. Chapter 5, up to the adversaries that learn", 90, "5.1, 5.3, 5.5"),
        Session("Chapter 8", 75, "8.1 to 8.4"),
        Session("Chapter 9", 75, "9.1 to 9.3"),
        Session("A project begins: a policy of one's own, or one of the problems below", 90),
    ),
    "Full course": (
        Session("Week 1. Chapter 1", 90, "1.1 to 1.4"),
        Session("Week 2. Chapter 2", 90, "2.1 to 2.4"),
        Session("Week 3. Chapter 3", 105, "3.1 to 3.4"),
        Session("Week 4. Chapter 4", 90, "4.1 to 4.4"),
        Session("Weeks 5 and 6. Chapter 5", 150, "5.1 to 5.6"),
        Session("Week 7. Chapter 6", 90, "6.1 to 6.3"),
        Session("Week 8. Chapter 7", 75, "7.1 to 7.3"),
        Session("Week 9. Chapter 8", 90, "8.1 to 8.4"),
        Session("Week 10. Chapter 9", 90, "9.1 to 9.3"),
        Session("Weeks 11 to 13. A project, and its presentation", 270),
    ),
}


@cache
def exercises() -> tuple[Exercise, ...]:
    """All exercises of the course, in their order."""
    return tuple(read_course())


def misconceptions(exercise: Exercise) -> list[str]:
    """The sentences by which a check corrects a known mistake.

    They are the texts in its dictionaries, which hold nothing else; or in its assertions, if it has no dictionary.

    Example:
        >>> by_number = {exercise.number: exercise for exercise in exercises()}
        >>> "That is the mean SQUARED error" in misconceptions(by_number["4.3"])
        True
    """
    check = inspect.unwrap(getattr(import_module(exercise.module), exercise.check))
    tree = ast.parse(textwrap.dedent(inspect.getsource(check)))
    parts = [part for node in ast.walk(tree) if isinstance(node, ast.Dict) for part in (*node.keys, *node.values)]
    texts = [part.value for part in parts if isinstance(part, ast.Constant) and isinstance(part.value, str)]
    texts = texts or [_text(node.msg) for node in ast.walk(tree) if isinstance(node, ast.Assert)]
    return [text for text in dict.fromkeys(texts) if " " in text]


def _text(message: ast.expr | None) -> str:
    """What an assertion says, with dots for the numbers of the moment."""
    parts = message.values if isinstance(message, ast.JoinedStr) else [message]
    text = "".join(part.value if isinstance(part, ast.Constant) else "..." for part in parts)
    return text.removeprefix("... ").removeprefix("...").lstrip(".:, ")


def paths() -> str:
    """The three paths as tables, with their sums."""
    shown = []
    for name, sessions in PATHS.items():
        rows = [f"| {session.what} | {session.exercises} | {session.minutes} |" for session in sessions]
        total = sum(session.minutes for session in sessions)
        hours = f"{total / 60:.0f} hours" if total % 60 == 0 else f"{total // 60} hours {total % 60} minutes"
        shown.append("\n".join([f"### {name}", "", "| session | exercises | minutes |", "|---|---|---|", *rows,
                                f"| **in all** | | **{total}** ({hours}) |"]))  # fmt: skip
    return "\n\n".join(shown)


def purposes() -> str:
    """Each exercise, what it is for, and the mistakes that its check knows, folded."""
    shown = []
    for exercise in exercises():
        known = misconceptions(exercise)
        shown.append(f"**{exercise.title}.** {PURPOSE[exercise.number]}")
        if known:
            listed = "\n".join(f"- {text.rstrip('.')}." for text in known)
            shown.append(f":::{{dropdown}} What goes wrong in {exercise.number}\n{listed}\n:::")
    return "\n\n".join(shown)
