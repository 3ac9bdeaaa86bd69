"""Random numbers that belong to an episode, so that an episode is the same whoever runs beside it."""

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor


def derived_seed(*keys: int) -> int:
    """A seed that belongs to these numbers: the same for the same, unrelated for others."""
    return int(np.random.SeedSequence(keys).generate_state(1)[0])


class RandomStreams:
    """Random rows, each from the stream of its own episode.

    Args:
        seed: the seed of whoever draws (an attack, a defence), so that two of them draw independently.
        episodes: one seed an episode; the rows of a draw belong to these episodes, in order. None: one stream for all
            rows, for offline use.
    """

    def __init__(self, seed: int, episodes: Sequence[int] | None = None):
        self.seed = seed
        keys = [[seed]] if episodes is None else [[seed, int(episode)] for episode in episodes]
        self.generators = [np.random.default_rng(key) for key in keys]

    def restart(self, i: int, episode: int) -> None:
        """Let row i belong to another episode from now on."""
        self.generators[i] = np.random.default_rng([self.seed, int(episode)])

    def normal(self, n: int, dim: int) -> Tensor:
        """Standard normal numbers ``[n, dim]``."""
        return self._rows(n, lambda g, rows: g.standard_normal((rows, dim), dtype=np.float32))

    def uniform(self, n: int, dim: int) -> Tensor:
        """Uniform numbers in [0, 1), ``[n, dim]``."""
        return self._rows(n, lambda g, rows: g.random((rows, dim), dtype=np.float32))

    def _rows(self, n: int, draw) -> Tensor:
        rows, rest = divmod(n, len(self.generators))
        if rest:
            raise ValueError(f"{n} rows for {len(self.generators)} episodes: reset with as many episodes as rows")
        return torch.from_numpy(np.concatenate([draw(g, rows) for g in self.generators]))
