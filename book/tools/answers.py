"""What a student's function answered to a check, recorded where it ran, so that the check can be run again elsewhere.

A student's code can do everything in its process: replace the check, print that it passed, leave early. So `make grade`
believes nothing that happens there. It takes the answers out, as plain data, and runs the check on them in a process in
which the student's code never was. An answer keeps the gradient of its sum, since some checks ask for it.
"""

import base64
import io
import json
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import wraps
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from detden_lite.checks.failure import CheckFailed, NotWritten
from detden_lite.theory.finite_mdp import FiniteMDP

MOST_BYTES = 20_000_000  # of all answers to one check; the largest of an honest function is below 1 MB


@dataclass
class Recorder:
    """Writes down what functions answer: ``answers[0]`` are those of the student's, others are of what it returned."""

    answers: list[list[dict]] = field(default_factory=list)

    def watch(self, function: Callable) -> Callable:
        """The same function, whose answers are written down."""
        written: list[dict] = []
        self.answers.append(written)

        @wraps(function)
        def watched(*arguments: Any) -> Any:
            try:
                result = function(*arguments)
            except Exception as error:
                written.append({"error": str(error)[:1000], "unwritten": isinstance(error, NotImplementedError)})
                raise
            answer, result = self.encode(result, arguments)
            written.append(answer)
            return result

        return watched

    def encode(self, value: Any, arguments: tuple = ()) -> tuple[dict, Any]:
        """The value as JSON can hold it, and the value itself; a function is watched from now on."""
        if value is None or isinstance(value, bool | int | float | str):
            return {"plain": value}, value
        if isinstance(value, tuple | list):
            pairs = [self.encode(part, arguments) for part in value]
            kind = "list" if isinstance(value, list) else "tuple"
            named = hasattr(value, "values") and hasattr(value, "indices")  # what torch's max(-1) gives
            whole = value if named or not pairs else type(value)(part for _, part in pairs)
            return {kind: [answer for answer, _ in pairs], "named": named}, whole
        if isinstance(value, Tensor):
            return {"tensor": _pack(value.detach().numpy()), "slopes": _slopes(value, arguments)}, value
        if isinstance(value, np.ndarray | np.generic):
            return {"array": _pack(value)}, value
        if isinstance(value, FiniteMDP):
            return {"mdp": [self.encode(part)[0] for part in (value.transition, value.reward, value.gamma)]}, value
        if callable(value):
            watched = self.watch(value)
            return {"function": len(self.answers) - 1}, watched
        return {"other": type(value).__name__}, value


def _leaves(arguments: tuple) -> list[Tensor]:
    """The tensors among the arguments, and in the networks among them, that a gradient can be asked of."""
    tensors = [part for a in arguments for part in (a.parameters() if isinstance(a, nn.Module) else [a])]
    return [tensor for tensor in tensors if isinstance(tensor, Tensor) and tensor.requires_grad]


def _slopes(value: Tensor, arguments: tuple) -> list[str | None] | None:
    if not value.requires_grad:
        return None
    found = torch.autograd.grad(value.sum(), _leaves(arguments), retain_graph=True, allow_unused=True)
    return [None if slope is None else _pack(slope.detach().numpy()) for slope in found]


def _pack(array: Any) -> str:
    buffer = io.BytesIO()
    np.save(buffer, np.asarray(array), allow_pickle=False)
    return base64.b64encode(buffer.getvalue()).decode()


def _unpack(text: str) -> np.ndarray:
    return np.load(io.BytesIO(base64.b64decode(text)), allow_pickle=False)


def record(path: str, module: str, check: str, function: Any) -> None:
    """Run the check on the student's function, and write its answers, and what the check said, to ``path``.

    Args:
        path: of the JSON file.
        module: where the check is, as in ``detden_lite.checks.attacks``.
        check: its name.
        function: the student's.
    """
    recorder = Recorder()
    said = None
    try:
        getattr(import_module(module), check)(recorder.watch(function) if callable(function) else function)
    except BaseException as error:  # an exit is no reason to give up
        said = str(error)[:1000] or type(error).__name__
    Path(path).write_text(json.dumps({"answers": recorder.answers, "said": said}), encoding="utf-8")


def replay(path: Path, module: str, check: str) -> tuple[str, str]:
    """Run the check on recorded answers. The first is "passed", "wrong" or "not written", the second what is said.

    The file comes from the student's process, so that it may hold anything.
    """
    try:
        if path.is_symlink() or not path.is_file() or path.stat().st_size > MOST_BYTES:
            return "wrong", "it left no answers, or too many"
        told = json.loads(path.read_text(encoding="utf-8"))
        answers, said = told["answers"], told["said"]
        player = Player(answers)
        getattr(import_module(module), check)(player.function(0))
    except NotWritten as error:
        return "not written", str(error)
    except CheckFailed as error:
        return "wrong", str(error)
    except Exception as error:
        return "wrong", f"its answers cannot be read ({type(error).__name__})"
    return ("wrong", str(said)) if said is not None else ("passed", "")


@dataclass
class Player:
    """Gives the recorded answers again, one after the other."""

    answers: list[list[dict]]

    def function(self, index: int) -> Callable:
        """What stands for the function of that number."""
        rest = iter(self.answers[index])

        def answer(*arguments: Any) -> Any:
            found = next(rest, None)
            if found is None:
                raise CheckFailed("the check was not run to its end in the student's process")
            if found.get("unwritten"):
                raise NotWritten(str(found["error"]))
            if "error" in found:
                raise CheckFailed(str(found["error"]))
            return self.decode(found, arguments)

        return answer

    def decode(self, found: dict, arguments: tuple = ()) -> Any:
        """The value of an encoded answer."""
        if "plain" in found:
            return found["plain"]
        if "tensor" in found:
            return _with_slopes(torch.from_numpy(_unpack(found["tensor"])), found["slopes"], arguments)
        if "array" in found:
            return _unpack(found["array"])[()]
        if "mdp" in found:
            return FiniteMDP(*(self.decode(part) for part in found["mdp"]))
        if "function" in found:
            return self.function(int(found["function"]))
        for kind, make in (("list", list), ("tuple", tuple)):
            if kind in found:
                if found.get("named"):
                    raise CheckFailed("it gives both values and indices, as torch's max(-1) does: take its values")
                return make(self.decode(part, arguments) for part in found[kind])
        return type(str(found["other"]), (), {})()


def _with_slopes(value: Tensor, slopes: list[str | None] | None, arguments: tuple) -> Tensor:
    """The value, with these gradients of its sum."""
    if slopes is None:
        return value
    added = torch.zeros(())
    for leaf, slope in zip(_leaves(arguments), slopes, strict=True):
        if slope is not None:
            added = added + ((leaf - leaf.detach()) * torch.from_numpy(_unpack(slope))).sum()
    return value + (added if added.requires_grad else torch.zeros((), requires_grad=True)) / value.numel()
