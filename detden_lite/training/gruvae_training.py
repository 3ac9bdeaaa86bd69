"""Training a GRU-VAE, as detector (input = target) or denoiser (input = attacked, target = true), by its ELBO."""

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
from tqdm import tqdm

from detden_lite.core.arguments import check_between, check_positive, check_whole
from detden_lite.core.random_streams import derived_seed
from detden_lite.defense.augmentation import Pair, check_pairs, intermittent
from detden_lite.defense.gruvae import GRUVAE, LEAST_STD, kl_divergence, reconstruction_loss
from detden_lite.training.regularizer import Regularizer
from detden_lite.training.torch_checkpoint import Parts, resume, save_checkpoint


@dataclass(frozen=True)
class VAERecipe:
    """How a GRU-VAE is trained.

    The training minimises beta (-L_den) + lam R, with R of ``detden_lite.training.regularizer``. The learning rate
    falls along half a cosine to zero at the last epoch; the paper says nothing of a schedule.

    Args:
        hidden: see ``GRUVAE``, as for the next three.
        layers: of both GRUs.
        latent: size of z.
        residual: whether the output is the input plus the decoder's.
        prior: "free" or "standard": see ``kl_divergence``.
        beta: weight of the KL term, at least 0: the variance of p(o | z, h) in z-scored units.
        epochs: times that every sequence is seen; at least 1.
        batch: sequences of a step; at least 1.
        chunk: time steps of truncated backpropagation, at least 1; the memory runs on from chunk to chunk.
        learning_rate: of Adam, at the beginning; above 0.
        lam: weight of the regularizer, at least 0, which leaves it out; below 0 R would be made large.
        least_share: the smallest share of an episode's steps that is attacked, 1 for all of them. The share is random,
            a new one for each sequence and epoch: see ``detden_lite.defense.augmentation.intermittent``.
        least_size: the smallest perturbation, as a fraction of the attack's own.

    Raises:
        ValueError: for another prior, or a number out of these ranges.

    Example:
        >>> VAERecipe(hidden=8, latent=2, epochs=1).beta
        0.001
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

    def __post_init__(self) -> None:
        names = ("hidden", "layers", "latent", "epochs", "batch", "chunk")
        check_whole(1, **{name: getattr(self, name) for name in names})
        check_positive(learning_rate=self.learning_rate)
        check_between(0, math.inf, beta=self.beta, lam=self.lam)
        check_between(0, 1, least_share=self.least_share, least_size=self.least_size)
        if self.prior not in ("free", "standard"):
            raise ValueError(f'prior must be "free" or "standard", not {self.prior!r}')


def train_gruvae(
    recipe: VAERecipe, pairs: Sequence[Pair], seed: int, checkpoint: Path | None = None,
    after_epoch: Callable[[int, GRUVAE], None] | None = None, label: str = "GRU-VAE",
    regularizer: Regularizer | None = None,
) -> GRUVAE:  # fmt: skip
    """Maximise the ELBO of L_det or L_den (section 3.1) over all pairs of (input, target) trajectories.

    Every epoch seeds torch's global generator by (seed, epoch), so that a resumed run equals one that never stopped.

    Observations are measured in their standard deviations. Some dimensions are dominated by the perturbation: an attack
    moves them by more than ten of these, so that the input tells nothing of the truth. They are measured in the largest
    perturbation instead, and a residual output does not add their input.

    Args:
        recipe: the hyperparameters.
        pairs: ``[(normal, normal)]`` for a detector; for a denoiser an ``(adversarial, normal)`` of each attack too.
        seed: of initialisation, order and latent samples.
        checkpoint: file to write after every epoch and to resume from; None for neither.
        after_epoch: called with (epoch, model) after each epoch; again for the last finished one of a resumed run.
        label: text of the progress bar.
        regularizer: R, for a recipe with ``lam`` above 0.

    Returns:
        The trained model, frozen.

    Raises:
        ValueError: if the checkpoint is of another recipe or seed, ``lam`` is above 0 and there is no regularizer, or
            ``pairs`` is empty, not finite or of different trajectories.
        ArtifactError: if the checkpoint is damaged.

    Example:
        >>> from detden_lite import Trajectories
        >>> waves = np.sin(np.arange(60, dtype=np.float32)).reshape(4, 5, 3)
        >>> normal = Trajectories(waves, lengths=np.array([5, 5, 4, 3]))
        >>> detector = train_gruvae(VAERecipe(hidden=8, latent=2, epochs=1), [(normal, normal)], seed=0)
        >>> detector.obs_dim, detector.training
        (3, False)
    """
    if recipe.lam and regularizer is None:
        raise ValueError(f"regularizer: the recipe weighs it with lam = {recipe.lam}, so give one")
    check_pairs(pairs)
    if regularizer and regularizer.victim.obs_dim != pairs[0][1].obs.shape[-1]:
        raise ValueError(
            f"regularizer: its victim has {regularizer.victim.obs_dim} observations, and pairs have others"
        )
    torch.manual_seed(seed)
    target = pairs[0][1]
    seen = torch.from_numpy(target.obs[target.mask])
    mean, std = seen.mean(0), seen.std(0).clamp(min=LEAST_STD)
    moved = torch.from_numpy(_largest_moves(pairs))
    dominated = moved > 10 * std
    residual = (~dominated).tolist() if recipe.residual and dominated.any() else recipe.residual
    model = GRUVAE(target.obs.shape[-1], recipe.hidden, recipe.layers, recipe.latent, residual)
    model.set_statistics(mean, torch.where(dominated, moved, std))
    optimizer = torch.optim.Adam(model.parameters(), lr=recipe.learning_rate)
    identity = dict(asdict(recipe), seed=seed, regularizer=regularizer.settings if regularizer and recipe.lam else None)
    defaults = dict(asdict(VAERecipe()), regularizer=None)
    parts: Parts = dict(model=model, optimizer=optimizer)
    first = resume(checkpoint, identity, defaults, parts) if checkpoint else 0
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
                save_checkpoint(checkpoint, identity, epoch + 1, parts)
            if after_epoch:
                after_epoch(epoch, model)
    return model.requires_grad_(False).eval()


def _largest_moves(pairs: Sequence[Pair]) -> np.ndarray:
    """The largest distance between an input and its target of each observation, ``[obs_dim]``."""
    return np.max([np.abs(a - b).max(0) for inputs, t in pairs for a, b in zip(inputs.obs, t.obs, strict=True)], axis=0)


def _train_on(
    model: GRUVAE, optimizer: torch.optim.Optimizer, recipe: VAERecipe, pairs: Sequence[Pair], batch: np.ndarray,
    regularizer: Regularizer | None,
) -> float:  # fmt: skip
    """One gradient step a chunk on the sequences ``batch``, ``[n, 2]`` of pair and position; returns the mean loss."""
    perturbed, true = (np.stack([pairs[p][side].obs[i] for p, i in batch]) for side in (0, 1))
    if (recipe.least_share, recipe.least_size) != (1, 1):
        seed = torch.randint(2**31, ()).item()
        perturbed = intermittent(true, perturbed, recipe.least_share, recipe.least_size, int(seed))
    inputs, targets = torch.from_numpy(perturbed), torch.from_numpy(true)
    mask = torch.from_numpy(np.stack([np.arange(inputs.shape[1]) < pairs[p][1].lengths[i] for p, i in batch]))
    some = slice(math.ceil(len(batch) / len(pairs)))  # R is taken of as many sequences an epoch as D_normal has
    total, state = 0.0, None
    starts = range(0, int(mask.sum(1).max()), recipe.chunk)
    for start in starts:
        part = slice(start, start + recipe.chunk)
        noise = torch.randn(*inputs[:, part].shape[:2], recipe.latent)
        result = model(inputs[:, part], noise, state)
        loss = reconstruction_loss(model, result.output, targets[:, part])
        loss = loss + recipe.beta * kl_divergence(result.mean, result.log_variance, recipe.prior)
        loss = (loss * mask[:, part]).sum() / mask[:, part].sum()
        if recipe.lam and regularizer:  # with the denoiser's memory of the earlier chunks, attacked or not
            memory = state and (state[0][:, some].contiguous(), state[1][:, some].contiguous())
            r = regularizer(model, targets[some, part], mask[some, part], noise[some], memory)
            loss = loss + recipe.lam * r
        state = result.state[0].detach(), result.state[1].detach()
        optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(model.parameters(), 1.0)
        optimizer.step()
        total += loss.item()
    return total / len(starts)
