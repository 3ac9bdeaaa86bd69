"""Random numbers that belong to an episode, so that an episode is the same whoever runs beside it."""

from collections.abc import Callable, Sequence

import numpy as np
import torch
from torch import Tensor

from detden_lite.core.arguments import check_whole


def derived_seed(*keys: int) -> int:
    """A seed made from these numbers: the same for the same, unrelated for others.

    Example:
        >>> derived_seed(0, 1) == derived_seed(0, 1), derived_seed(0, 1) == derived_seed(1, 0)
        (True, False)
    """
    return int(np.random.SeedSequence(keys).generate_state(1)[0])


class RandomStreams:
    """Random rows, each from the generator of its own episode.

    Args:
        seed: of the part that uses these numbers (an attack, a defence), so that two parts are independent.
        episodes: one seed an episode; the rows of random numbers belong to these episodes, in order. None: one
            generator for all rows, for offline use.

    Raises:
        ValueError: if a seed is no whole number of at least 0, or ``episodes`` is empty.

    Example:
        >>> alone, together = RandomStreams(0, [7]), RandomStreams(0, [5, 7])
        >>> bool((alone.normal(1, 3)[0] == together.normal(2, 3)[1]).all())
        True
    """

    def __init__(self, seed: int, episodes: Sequence[int] | None = None) -> None:
        check_whole(0, seed=seed)
        if episodes is not None and not len(episodes):
            raise ValueError("episodes is empty: give one seed for each episode")
        self.seed = seed
        self.generators = [np.random.default_rng([seed])] if episodes is None else [self._of(e) for e in episodes]

    def _of(self, episode: int) -> np.random.Generator:
        check_whole(0, **{"the seed of an episode": episode})
        return np.random.default_rng([self.seed, int(episode)])

    def restart(self, i: int, episode: int) -> None:
        """Let row i belong to another episode from now on."""
        self.generators[i] = self._of(episode)

    def normal(self, n: int, dim: int) -> Tensor:
        """Standard normal numbers ``[n, dim]``."""
        return self._rows(n, lambda g, rows: g.standard_normal((rows, dim), dtype=np.float32))

    def uniform(self, n: int, dim: int) -> Tensor:
        """Uniform numbers in [0, 1), ``[n, dim]``."""
        return self._rows(n, lambda g, rows: g.random((rows, dim), dtype=np.float32))

    def _rows(self, n: int, random: Callable[[np.random.Generator, int], np.ndarray]) -> Tensor:
        rows, rest = divmod(n, len(self.generators))
        if rest:
            raise ValueError(f"{n} rows for {len(self.generators)} episodes: reset with as many episodes as rows")
        return torch.from_numpy(np.concatenate([random(g, rows) for g in self.generators]))
