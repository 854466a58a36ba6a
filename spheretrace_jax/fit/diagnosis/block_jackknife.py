"""Block jackknife: how far an answer scatters when blocks of the pictures are left out.

Standard deviations from J^T J take residuals for white noise. Where the model is wrong residuals
have a shape, whole regions pull the answer their way, and it is off by many such deviations. The
delete-a-group jackknife asks the regions themselves: with the normal equations H_b, g_b of m
blocks, leaving out block b moves the solution by Delta_b = -(H - H_b)^+ (g - g_b) to first order,
and the covariance is (m - 1)/m sum Delta_b Delta_b^T. It is the cluster-robust sandwich CV3 of
linear regression.

Sources: Shao and Wu, "A General Theory for Jackknife Variance Estimation", Annals of Statistics 17
(1989); Liang and Zeger, "Longitudinal Data Analysis Using Generalized Linear Models", Biometrika 73
(1986); MacKinnon, Nielsen and Webb, "Cluster-Robust Inference: A Guide to Empirical Practice",
Journal of Econometrics 232 (2023), eq. 15.
"""

from collections.abc import Sequence
from functools import cached_property

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int, PyTree

from ..problem.problem import Problem, normal_at

# How often pixels are halved: 2^4 = 16 blocks. More of them are smaller than what a wrong model
# leaves behind, and pull alike; fewer scatter more. Each takes as long as one step of the fit.
_HALVINGS = 4
_BLOCKS = 1 << _HALVINGS

# The least share of a direction's information that what is left over must have; less counts as so
# much. Without this a highlight that one block alone shows would move without limit.
_LEAST_SHARE = 0.1

# The excess of the blocks' pull over that of white noise, in standard deviations, from which it is
# no chance: a right model exceeds 5 once in many thousand fits.
_PULL = 5


class NormalSums(eqx.Module):
    """J^T J and J^T r of a part of the pictures, where all of J^T J is the unit matrix."""

    square: Float[np.ndarray, "known known"]
    gradient: Float[np.ndarray, " known"]

    def __add__(self, other: "NormalSums") -> "NormalSums":
        return NormalSums(self.square + other.square, self.gradient + other.gradient)

    def __sub__(self, other: "NormalSums") -> "NormalSums":
        return NormalSums(self.square - other.square, self.gradient - other.gradient)

    @cached_property
    def step(self) -> Float[np.ndarray, " known"]:
        """Returns the Gauss-Newton step to what this part alone says."""
        share, vectors = np.linalg.eigh(self.square)
        return -vectors @ ((vectors.T @ self.gradient) / np.maximum(share, _LEAST_SHARE))


class BlockJackknife:
    """The normal equations of blocks of a fit's pictures, at its solution.

    Steps and covariances are those of the unknowns in directions that the pictures determine, and
    of what no bound holds.
    """

    def __init__(
        self,
        problem: Problem,
        values: PyTree,
        square: Float[np.ndarray, "free free"],
        objects: Sequence[Int[np.ndarray, "height width"]],
        left: Float[np.ndarray, " free"],
    ):
        """Sums the blocks' equations, by the program of the fit's steps.

        **Arguments:** `square`: J^T J in the determined directions, 0 in others and where bounds
        hold, with priors. `objects`: of each picture which object its pixels show. `left`: the step
        that the solver did not take, after which the blocks are compared.
        """
        self._left = left
        # the pictures' residuals only: priors are knowledge that no block has
        self._problem, self._values = problem.without_priors(), values
        scale = np.sqrt(np.diag(square))
        scale = np.where(scale > 0, scale, 1)
        size, vectors = np.linalg.eigh(square / scale[:, None] / scale[None, :])
        shows = size > square.shape[0] * np.finfo(np.float64).eps * 1e3
        #: from the steps of `NormalSums` to the unknowns'
        self.unwhiten = vectors[:, shows] / np.sqrt(size[shows]) / scale[:, None]
        pairs = zip(problem.targets, objects, strict=True)
        self._numbers = [block_numbers(np.asarray(t.counts), o) for t, o in pairs]
        self.blocks = [self._sums([n == b for n in self._numbers]) for b in range(_BLOCKS)]
        known = self.unwhiten.shape[1]
        #: with priors, after the step that is left
        self.whole = NormalSums(np.eye(known), np.zeros(known))

    def _sums(self, weights: Sequence[np.ndarray]) -> NormalSums:
        """Sums with other weights. **Arguments:** `weights`: a factor of each pixel's residual."""
        targets = self._problem.targets
        factor = lambda w, t: t.weight * jnp.asarray(w[..., None], t.weight.dtype)
        weight = [factor(w, t) for w, t in zip(weights, targets, strict=True)]
        part = eqx.tree_at(lambda p: [t.weight for t in p.targets], self._problem, weight)
        normal = normal_at(part, self._values)
        square, gradient = (np.asarray(x, np.float64) for x in (normal.square, normal.gradient))
        to = self.unwhiten
        return NormalSums(to.T @ square @ to, to.T @ (gradient + square @ self._left))

    def excess(self, noise: float) -> float:
        """Returns how much more blocks pull than white noise would, in its standard deviations.

        Of white noise g_b has the covariance noise^2 (H_b - H_b^2), so that the sum of
        g_b^T H_b^+ g_b / noise^2 is chi-squared, with the ranks of all H_b less that of H degrees
        of freedom.
        """
        pull, freedom = 0.0, -float(self.unwhiten.shape[1])
        for block in self.blocks:
            share, vectors = np.linalg.eigh(block.square)
            shows = share > 1e-9
            pull += np.sum((vectors.T @ block.gradient)[shows] ** 2 / share[shows])
            freedom += np.count_nonzero(shows)
        if freedom <= 0 or noise <= 0:
            return 0.0
        return float((pull / noise**2 - freedom) / np.sqrt(2 * freedom))

    def is_structured(self, noise: float) -> bool:
        """Tells whether blocks pull more than white noise of some standard deviation would."""
        return self.excess(noise) > _PULL

    @property
    def scatter(self) -> Float[np.ndarray, "free blocks"]:
        """Returns S with S S^T the jackknife's covariance of the unknowns."""
        steps = [(self.whole - block).step for block in self.blocks]
        factor = np.sqrt((_BLOCKS - 1) / _BLOCKS)
        return factor * self.unwhiten @ np.stack(steps, axis=1)

    def halves(self, bright: Sequence[Bool[np.ndarray, "height width"]]) -> np.ndarray:
        """Returns S with S S^T how the unknowns move to halves of the pictures.

        The mean square of two halves each, added up: halves of each object along its longer and
        its shorter side, and its bright and dark one.

        **Arguments:** `bright`: which pixels are in the brighter half of their object.
        """
        steps = []
        for bit in (0, 1):
            chosen = [b for k, b in enumerate(self.blocks) if k >> bit & 1]
            steps += self._apart(sum(chosen[1:], chosen[0]))
        steps += self._apart(self._sums(bright))
        return self.unwhiten @ np.stack(steps, axis=1) / np.sqrt(2)

    def _apart(self, half: NormalSums) -> list[np.ndarray]:
        """Returns the steps to what each half of the pictures says, with the priors."""
        other = sum(self.blocks[1:], self.blocks[0]) - half
        return [(self.whole - part).step for part in (half, other)]

    def reweighted(self, weights: Sequence[Float[np.ndarray, "height width"]]) -> np.ndarray:
        """Returns how the unknowns move with other weights, as one column.

        **Arguments:** `weights`: a factor of each pixel's residual.
        """
        pictures = sum(self.blocks[1:], self.blocks[0])
        known = self.whole - pictures  # the priors
        return self.unwhiten @ (self._sums(weights) + known).step[:, None]


def block_numbers(
    counts: Bool[np.ndarray, "height width"], objects: Int[np.ndarray, "height width"]
) -> Int[np.ndarray, "height width"]:
    """Returns the number of each pixel's block, from 0 to 15; -1 where it does not count.

    The pixels of each object are halved along its longer side, four times (recursive coordinate
    bisection). A block has a piece of each object, so that no block is all that tells of one.
    """
    row, column = np.nonzero(counts)
    number = np.zeros(row.size, np.int64)
    _, group = np.unique(objects[row, column], return_inverse=True)
    for k in range(_HALVINGS):
        size = np.bincount(group)
        extents = [_extent(x, group, size.size) for x in (row, column)]
        along = np.where((extents[0] >= extents[1])[group], row, column)
        order = np.lexsort((along, group))
        rank = np.empty_like(order)
        rank[order] = np.arange(order.size)
        rank -= (np.cumsum(size) - size)[group]
        second = 2 * rank >= size[group]
        number += second.astype(np.int64) << k
        group = 2 * group + second
    numbers = np.full(counts.shape, -1)
    numbers[row, column] = number
    return numbers


def bright_halves(
    picture: Float[np.ndarray, "height width"],
    counts: Bool[np.ndarray, "height width"],
    objects: Int[np.ndarray, "height width"],
) -> Bool[np.ndarray, "height width"]:
    """Returns which counted pixels are brighter than the median of their object's."""
    bright = np.zeros(counts.shape, bool)
    for number in np.unique(objects[counts]):
        here = counts & (objects == number)
        bright |= here & (picture > np.median(picture[here]))
    return bright


def _extent(x: np.ndarray, group: np.ndarray, groups: int) -> np.ndarray:
    """Returns the largest less the least number of each group."""
    least, most = np.full(groups, np.iinfo(np.int64).max), np.full(groups, -1)
    np.minimum.at(least, group, x)
    np.maximum.at(most, group, x)
    return most - least
