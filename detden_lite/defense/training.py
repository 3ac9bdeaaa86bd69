"""Training a GRU-VAE, as detector (input = target) or denoiser (input = attacked, target = true), by its ELBO."""

import io
import json
import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
from tqdm import tqdm

from detden_lite.core.files import replace_file
from detden_lite.core.random_streams import derived_seed
from detden_lite.core.types import Trajectories
from detden_lite.defense.augmentation import intermittent
from detden_lite.defense.gruvae import GRUVAE, LEAST_STD, kl_divergence, reconstruction_loss
from detden_lite.defense.regularizer import Regularizer


@dataclass(frozen=True)
class VAERecipe:
    """How a GRU-VAE is trained.

    What is minimised is beta (-L_den) + lam R, with R of ``detden_lite.defense.regularizer``. The learning rate falls
    along half a cosine to zero at the last epoch; the paper says nothing of a schedule.

    Args:
        hidden: see ``GRUVAE``, as for the next three.
        layers: of both GRUs.
        latent: size of z.
        residual: whether the output is the input plus the decoder's.
        prior: "free" or "standard": see ``kl_divergence``.
        beta: weight of the KL term: the variance of p(o | z, h) in z-scored units.
        epochs: times that every sequence is seen; at least 1.
        batch: sequences of a step; at least 1.
        chunk: time steps of truncated backpropagation, at least 1; the memory runs on from chunk to chunk.
        learning_rate: of Adam, at the beginning.
        lam: weight of the regularizer; 0 leaves it out.
        least_share: the smallest share of an episode's steps that is attacked, 1 for all of them, drawn anew for each
            sequence and epoch: see ``detden_lite.defense.augmentation.intermittent``.
        least_size: the smallest perturbation, in parts of the attack's own.

    Raises:
        ValueError: for another prior, or a number out of these ranges.
    """

    hidden: int = 64
    layers: int = 1
    latent: int = 64
    residual: bool = False
    prior: str = "free"
    beta: float = 1e-3
    epochs: int = 50
    batch: int = 128
    chunk: int = 25
    learning_rate: float = 1e-3
    lam: float = 0.0
    least_share: float = 1.0
    least_size: float = 1.0

    def __post_init__(self):
        for name in ("epochs", "batch", "chunk"):
            if not getattr(self, name) >= 1:
                raise ValueError(f"{name} must be at least 1, not {getattr(self, name)}")
        for name in ("least_share", "least_size"):
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"{name} must be between 0 and 1, not {getattr(self, name)}")
        if self.prior not in ("free", "standard"):
            raise ValueError(f'prior must be "free" or "standard", not {self.prior!r}')
        if not self.lam >= 0:
            raise ValueError(f"lam must be at least 0, not {self.lam}: R would be made large")


def train_gruvae(
    recipe: VAERecipe,
    pairs: list[tuple[Trajectories, Trajectories]],
    seed: int,
    checkpoint: Path | None = None,
    after_epoch: Callable[[int, GRUVAE], None] | None = None,
    label: str = "GRU-VAE",
    regularizer: Regularizer | None = None,
) -> GRUVAE:
    """Maximise the ELBO of L_det or L_den (section 3.1) over all pairs of (input, target) trajectories.

    Every epoch seeds torch's global generator by (seed, epoch), so that a run resumed from its checkpoint equals one
    that never stopped.

    Observations are measured in their standard deviations. Where an attack moves one by more than ten of these, its own
    value tells nothing: it is measured in the largest move instead, and a residual output leaves it out.

    Args:
        recipe: the hyperparameters.
        pairs: ``[(normal, normal)]`` for a detector; for a denoiser an ``(adversarial, normal)`` of each attack too.
        seed: of initialisation, order and latent samples.
        checkpoint: file to write after every epoch and to resume from; None for neither.
        after_epoch: called with (epoch, model) after each epoch; a resumed run first calls it again for the last
            finished one.
        label: text of the progress bar.
        regularizer: R, for a recipe with ``lam`` above 0.

    Returns:
        The trained model, frozen.

    Raises:
        ValueError: if the checkpoint is of another recipe or seed, or ``lam`` is above 0 and there is no regularizer.
    """
    if recipe.lam and regularizer is None:
        raise ValueError(f"regularizer: the recipe weighs it with lam = {recipe.lam}, so give one")
    torch.manual_seed(seed)
    target = pairs[0][1]
    seen = torch.from_numpy(target.obs[target.mask])
    mean, std = seen.mean(0), seen.std(0).clamp(min=LEAST_STD)
    moved = torch.from_numpy(_largest_moves(pairs))
    drowned = moved > 10 * std
    residual = recipe.residual
    if residual and drowned.any():
        residual = (~drowned).tolist()
    model = GRUVAE(target.obs.shape[-1], recipe.hidden, recipe.layers, recipe.latent, residual)
    model.set_statistics(mean, torch.where(drowned, moved, std))
    optimizer = torch.optim.Adam(model.parameters(), lr=recipe.learning_rate)
    identity = dict(asdict(recipe), seed=seed, regularizer=regularizer.settings if recipe.lam else None)
    first = _resume(checkpoint, identity, model, optimizer) if checkpoint else 0
    if first and after_epoch:
        after_epoch(first - 1, model)

    # One index over all pairs: the i-th sequence of the p-th pair.
    index = np.concatenate([np.stack([np.full(len(t), p), np.arange(len(t))], 1) for p, (_, t) in enumerate(pairs)])
    with tqdm(range(first, recipe.epochs), initial=first, total=recipe.epochs, desc=label, unit="epoch") as bar:
        for epoch in bar:
            torch.manual_seed(derived_seed(seed, epoch))
            falling = (1 + math.cos(math.pi * epoch / recipe.epochs)) / 2
            optimizer.param_groups[0]["lr"] = recipe.learning_rate * falling
            order = torch.randperm(len(index)).numpy()
            losses = [
                _train_on(model, optimizer, recipe, pairs, index[order[i : i + recipe.batch]], regularizer)
                for i in range(0, len(order), recipe.batch)
            ]
            bar.set_postfix(loss=f"{np.mean(losses):.4f}")
            if checkpoint:
                _save(checkpoint, identity, epoch + 1, model, optimizer)
            if after_epoch:
                after_epoch(epoch, model)
    return model.requires_grad_(False).eval()


def _largest_moves(pairs: list[tuple[Trajectories, Trajectories]]) -> np.ndarray:
    """The largest distance between an input and its target of each observation, ``[obs_dim]``."""
    return np.max([np.abs(a - b).max(0) for inputs, t in pairs for a, b in zip(inputs.obs, t.obs, strict=True)], axis=0)


def _train_on(model: GRUVAE, optimizer, recipe: VAERecipe, pairs, batch: np.ndarray, regularizer) -> float:
    def gather(side: int) -> np.ndarray:
        return np.stack([pairs[p][side].obs[i] for p, i in batch])

    inputs, targets = gather(0), gather(1)
    if (recipe.least_share, recipe.least_size) != (1, 1):
        seed = int(torch.randint(2**31, ()))
        inputs = intermittent(targets, inputs, recipe.least_share, recipe.least_size, seed)
    inputs, targets = torch.from_numpy(inputs), torch.from_numpy(targets)
    mask = torch.from_numpy(np.stack([np.arange(inputs.shape[1]) < pairs[p][1].lengths[i] for p, i in batch]))
    some = slice(math.ceil(len(batch) / len(pairs)))  # R is taken of as many sequences an epoch as D_normal has
    state, total = None, 0.0
    starts = range(0, int(mask.sum(1).max()), recipe.chunk)
    for start in starts:
        part = slice(start, start + recipe.chunk)
        noise = torch.randn(*inputs[:, part].shape[:2], recipe.latent)
        result = model(inputs[:, part], noise, state)
        loss = reconstruction_loss(model, result.output, targets[:, part])
        loss = loss + recipe.beta * kl_divergence(result.mean, result.log_variance, recipe.prior)
        loss = (loss * mask[:, part]).sum() / mask[:, part].sum()
        if recipe.lam:  # with the memory of what the denoiser has seen up to here, attacked or not
            memory = state and tuple(s[:, some].contiguous() for s in state)
            r = regularizer(model, targets[some, part], mask[some, part], noise[some], memory)
            loss = loss + recipe.lam * r
        state = tuple(s.detach() for s in result.state)
        optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(model.parameters(), 1.0)
        optimizer.step()
        total += loss.item()
    return total / len(starts)


def _save(path: Path, identity: dict, epochs: int, model: GRUVAE, optimizer) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    content = dict(
        identity=json.dumps(identity), epochs=epochs, model=model.state_dict(), optimizer=optimizer.state_dict()
    )
    file = io.BytesIO()
    torch.save(content, file)
    replace_file(path, file.getvalue())


def _resume(path: Path, identity: dict, model: GRUVAE, optimizer) -> int:
    if not path.exists():
        return 0
    saved = torch.load(path, weights_only=True)
    # What a checkpoint does not mention did not exist when it was written, and was what is now the default.
    known = dict(asdict(VAERecipe()), regularizer=None) | json.loads(saved["identity"])
    if known != json.loads(json.dumps(identity)):
        raise ValueError(f"{path} is a checkpoint of another recipe ({saved['identity']}); remove it or take another")
    model.load_state_dict(saved["model"])
    optimizer.load_state_dict(saved["optimizer"])
    return saved["epochs"]
