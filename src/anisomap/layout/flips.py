"""Joint optimisation of the orientations of all modules by chains of flips."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from anisomap.layout.evidence import Evidence

_FAR = 4.0  # maximum spacings between modules that constrain each other; chosen by hand
_LONGEST = 12  # maximum number of flips in a chain
_LEAST = 1e-2  # minimum gain of a chain in nats, above rounding errors


@dataclass(frozen=True, eq=False)
class Orientations:
    """Log-likelihood of the orientations of M modules, with O possible orientations each.

    If a whole patch is mirrored, flipping a single module has no gain. Chains of flips are
    therefore followed from each module: each step makes the best remaining flip, even if it is a
    loss, and the best initial part of a chain is kept (Kernighan & Lin 1970, Bell System Technical
    Journal 49(2): 291-307).

    alone (M, O): Of each module with sensors without a module, minus the price of a change.
    pairs (M, M, O, O): Of pairs of modules.
    free (M,): Modules that may be flipped.
    """

    alone: NDArray[np.float32]
    pairs: NDArray[np.float32]
    free: NDArray[np.bool_]

    @classmethod
    def of(
        cls,
        evidence: Evidence,
        members: Sequence[NDArray[np.intp]],
        images: Sequence[NDArray[np.float64]],
        free: NDArray[np.bool_],
        price: NDArray[np.float64],
    ) -> Orientations:
        """Compute likelihoods for modules whose sensors may be at images (O, m, k).

        price (O,): Price of each orientation, in nats.
        """
        kept = [evidence.usable[inside] for inside in members]
        sensors = [inside[chosen] for inside, chosen in zip(members, kept, strict=True)]
        at = [image[:, chosen] for image, chosen in zip(images, kept, strict=True)]
        n_modules, n_turns, k = len(members), at[0].shape[0], at[0].shape[2]
        loose = evidence.usable.copy()
        loose[np.concatenate(members)] = False

        def ratios(
            m: int, others: NDArray[np.intp], places: NDArray[np.float64]
        ) -> NDArray[np.float32]:
            shape = (n_turns, len(sensors[m]), len(places) // len(others), len(others))
            bins = evidence.falloff.bins(cdist(at[m].reshape(-1, k), places)).reshape(shape)
            codes = evidence.codes[np.ix_(sensors[m], others)][None, :, None, :]
            return np.asarray(evidence.falloff.ratio(codes, bins).sum(axis=(1, 3)))

        alone = np.zeros((n_modules, n_turns), np.float32)
        pairs = np.zeros((n_modules, n_modules, n_turns, n_turns), np.float32)
        if (rest := np.flatnonzero(loose)).size:
            here = evidence.positions[rest]
            alone += np.stack([ratios(m, rest, here)[:, 0] for m in range(n_modules)])
        alone -= price
        middle = np.stack([image.mean(axis=(0, 1)) for image in images])
        radius = [
            np.linalg.norm(image - c, axis=2).max() for image, c in zip(images, middle, strict=True)
        ]
        far = _FAR * evidence.falloff.spacing + np.add.outer(radius, radius)
        known = np.array([len(inside) > 0 for inside in sensors])
        near = (cdist(middle, middle) <= far) & np.outer(known, known)
        for a, b in np.argwhere(np.triu(near, 1)).tolist():
            pairs[a, b] = ratios(a, sensors[b], at[b].reshape(-1, k))
            pairs[b, a] = pairs[a, b].T
        return cls(alone, pairs, free)

    def best(self, turn: NDArray[np.intp]) -> NDArray[np.intp]:
        """Improve orientations (M,) until no chain of flips improves them."""
        for _ in range(len(turn)):
            gain, better = self._chain(turn)
            if gain <= _LEAST:
                break
            turn = better
        return turn

    def _chain(self, turn: NDArray[np.intp]) -> tuple[float, NDArray[np.intp]]:
        """Follow a chain from each flip, all simultaneously, and return the best initial part."""
        n_modules, n_turns = self.alone.shape
        modules = np.arange(n_modules)
        starts = np.ones((n_modules, n_turns), bool) & self.free[:, None]
        starts[modules, turn] = False
        m, o = np.nonzero(starts)
        if not m.size:
            return 0.0, turn
        chains = np.arange(m.size)
        now = np.tile(turn, (m.size, 1))
        field = self.alone + self.pairs[:, modules, :, turn].sum(axis=0)  # each orientation, (M, O)
        fields = np.repeat(field[None], m.size, axis=0)
        locked = np.tile(~self.free, (m.size, 1))
        gained = np.zeros(m.size)
        most, best = np.full(m.size, -np.inf), now.copy()
        for _ in range(min(int(self.free.sum()), _LONGEST)):
            gained += fields[chains, m, o] - fields[chains, m, now[chains, m]]
            fields += self.pairs[m, :, o, :] - self.pairs[m, :, now[chains, m], :]
            now[chains, m] = o
            locked[chains, m] = True
            better = gained > most
            most[better], best[better] = gained[better], now[better]
            left = fields - np.take_along_axis(fields, now[:, :, None], axis=2)
            np.put_along_axis(left, now[:, :, None], -np.inf, axis=2)
            left[locked] = -np.inf
            following = left.reshape(m.size, -1).argmax(axis=1)
            if not np.isfinite(left.reshape(m.size, -1)[chains, following]).all():
                break
            m, o = np.divmod(following, n_turns)
        chosen = int(most.argmax())
        return float(most[chosen]), best[chosen]
