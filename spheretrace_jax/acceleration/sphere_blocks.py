"""`SphereBlocks`: candidate spheres in the cones of pixels, found block by block.

Spheres are sorted along a space-filling curve into blocks, each with a bounding sphere. A block
that no cone of many pixels meets is skipped; of the others every sphere is tested, without a gather
and as one bit. Cones that mirrors have spread meet many cells of a grid, and many nodes of a tree:
for 2048 pixels and 1,000 spheres a tree takes 5 times as long, and is faster from 10,000 on.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int, UInt32

from ..base.types import Ids, Index, Mask, PixelArray
from ..base.vec import SplitVec, Vec, components, dot, norm
from ..scene.camera import Ray
from .binning import NO_SPHERE, ROUNDING_ULPS, Cluster, T, Visitor, stable_order, take
from .candidate_list import Found, Search, visit_listed

# Spheres of a block, as many as an integer has bits.
_BLOCK = 32

# Bits of a place along each axis on the space-filling curve.
_BITS = 10

# Factor by which spheres are taken to be larger: no rounding error hides one.
_SLACK = 1 + 1e-3


class PixelCone(eqx.Module):
    """What a pixel sees: its ray, and how wide the pixel is along the ray."""

    ray: Ray
    radius: PixelArray  #: where the ray starts, world units
    spread: PixelArray  #: growth of the radius per unit of distance from the ray's origin
    alive: Mask  #: true where there is a pixel; others meet nothing
    start: PixelArray | int = 0  #: the distance before which no sphere matters
    end: PixelArray | float = jnp.inf  #: spheres that begin more than R behind it do not matter

    def meets(self, center: Vec, radius: PixelArray) -> Mask:
        """Tests whether any of a sphere, or of those in a bounding sphere, may lie in the cone."""
        to_center = center - self.ray.origin
        along, square = dot(to_center, self.ray.direction), dot(to_center, to_center)
        reach = (radius + self.radius + self.spread * (jnp.sqrt(square) + radius)) * _SLACK
        near = square - along * along <= reach * reach + self._rounding * square
        far = (along - 2 * radius * _SLACK) * (1 - self._rounding) > self.end
        return near & (along + radius * _SLACK > self.start) & ~far & self.alive

    def distance(self, center: Vec, radius: PixelArray) -> PixelArray:
        """Returns the least distance at which a sphere may matter."""
        along = dot(center - self.ray.origin, self.ray.direction)
        return along - radius * _SLACK - self._rounding * jnp.abs(along)

    @property
    def _rounding(self) -> float:
        return ROUNDING_ULPS * float(jnp.finfo(self.ray.direction.x.dtype).eps)


class SphereBlocks(eqx.Module):
    """Spheres in blocks; the last block is filled with spheres that nothing meets: radius nan."""

    center: Vec
    radius: Float[Array, "blocks block"]
    ids: Int[Array, "blocks block"]
    block_center: Vec
    block_radius: Float[Array, " blocks"]

    def visit(self, cone: PixelCone, visitor: Visitor, rays: Any, state: T) -> T:
        """Lets pixels test the spheres of the blocks that any of their cones meets.

        For visitors that cost little. **Arguments:** see `Bins.visit`; a sphere is the same for all
        pixels.
        """

        def visit_block(state: T, block: tuple) -> tuple[T, None]:
            *bound, spheres = block

            def test(k: Index, state: T) -> T:
                center, radius, ids = jax.tree.map(lambda x: x[k], spheres)
                return visitor(rays, center, radius, ids, state)

            some = jnp.any(cone.meets(*bound))
            visit = lambda state: lax.fori_loop(0, _BLOCK, test, state)
            return lax.cond(some, visit, lambda state: state, state), None

        blocks = self.block_center, self.block_radius, (self.center, self.radius, self.ids)
        return lax.scan(visit_block, state, blocks)[0]

    def visit_each(
        self,
        cone: PixelCone,
        max_distance: Callable[[T], PixelArray],
        sorts: bool,
        visitor: Visitor,
        rays: Any,
        state: T,
    ) -> T:
        """Lets each pixel test the spheres in its cone; see `Bins.visit`.

        **Arguments:** `max_distance`: from a state to the distance beyond which no sphere changes
        the state. `sorts`: whether the nearest spheres come first.
        """
        words = self._meeting(cone)
        center, radius = jax.tree.map(jnp.ravel, (self.center, self.radius))

        def step(own: tuple[PixelCone, Array], number: Ids, limit: PixelArray) -> Found:
            cone, words = own
            # a list may have been full at the very last sphere
            row = jnp.minimum(number // _BLOCK, len(words) - 1)
            word = jnp.take_along_axis(words, row[None], axis=0, mode="promise_in_bounds")[0]
            rest = jnp.where(number < radius.size, word >> (number % _BLOCK).astype(jnp.uint32), 0)
            # the zeros at the end of the rest lead to its next bit
            zeros = lax.population_count(~rest & (rest - 1)).astype(jnp.int32)
            found = jnp.where(rest > 0, number + zeros, row * _BLOCK)
            sphere = jax.tree.map(lambda x: take(x, found), (center, radius))
            distance = cone.distance(*sphere)
            new = jnp.where(rest > 0, found + 1, (row + 1) * _BLOCK)
            new = jnp.where(new < radius.size, new, -1)
            return Found(new, jnp.where((rest > 0) & (distance <= limit), found, -1), distance)

        length = jnp.sum(lax.population_count(words), axis=0).astype(jnp.int32)
        start = jnp.where(length > 0, 0, -1).astype(jnp.int32)
        search = Search(step, self._sphere, max_distance, (cone, words), start, length, sorts)
        return visit_listed(search, visitor, rays, state)

    def _meeting(self, cone: PixelCone) -> UInt32[Array, "blocks *pixels"]:
        """Finds the spheres of each block that pixels' cones meet: one bit for each."""

        def word(block: tuple) -> UInt32[Array, "*pixels"]:
            *bound, spheres = block

            def add(k: Index, bits: Array) -> Array:
                bit = jnp.uint32(1) << jnp.asarray(k).astype(jnp.uint32)
                meets = cone.meets(*jax.tree.map(lambda x: x[k], spheres))
                return bits | jnp.where(meets, bit, jnp.uint32(0))

            none = jnp.zeros(cone.alive.shape, jnp.uint32)
            some = jnp.any(cone.meets(*bound))
            return lax.cond(some, lambda: lax.fori_loop(0, _BLOCK, add, none), lambda: none)

        return lax.map(word, (self.block_center, self.block_radius, (self.center, self.radius)))

    def _sphere(self, number: Ids) -> tuple[Vec, PixelArray, Ids]:
        """Returns centre, radius and id of spheres; radius nan and `NO_SPHERE` for -1."""
        there, number = number >= 0, jnp.maximum(number, 0)
        columns = jax.tree.map(jnp.ravel, (self.center, self.radius, self.ids))
        center, radius, ids = jax.tree.map(lambda x: take(x, number), columns)
        return center, jnp.where(there, radius, jnp.nan), jnp.where(there, ids, NO_SPHERE)


def build_blocks(center: Vec, radius: PixelArray, group: Cluster) -> SphereBlocks:
    """Sorts spheres into blocks. **Arguments:** `group`: the region of most of them."""
    order = _curve_order(center, group)
    fill = -order.size % _BLOCK
    block = lambda x: x.reshape(-1, _BLOCK)
    center, radius = jax.tree.map(lambda x: take(x, order), (center, radius))
    center = SplitVec(*(block(jnp.pad(x, (0, fill), mode="edge")) for x in components(center)))
    radius = block(jnp.pad(radius, (0, fill), constant_values=jnp.nan))
    middle = SplitVec(*(_middle(x, radius) for x in components(center)))
    reach = norm(center - jax.tree.map(lambda x: x[:, None], middle)) + radius
    ids = block(jnp.pad(order, (0, fill), constant_values=NO_SPHERE))
    return SphereBlocks(center, radius, ids, middle, jnp.nanmax(reach, axis=1))


def _middle(x: Float[Array, "blocks block"], radius: Array) -> Float[Array, " blocks"]:
    """Returns the middle of blocks of spheres along an axis."""
    return (jnp.nanmin(x - radius, axis=1) + jnp.nanmax(x + radius, axis=1)) / 2


def _curve_order(center: Vec, group: Cluster) -> Ids:
    """Returns the order of spheres along a space-filling curve (Morton, 1966)."""
    code = jnp.zeros(center.x.shape, jnp.int32)
    low = group.middle - group.half_width
    axes = zip(components(center), components(low), components(group.half_width), strict=True)
    for axis, (x, first, half) in enumerate(axes):
        place = (x - first) * (2.0 ** (_BITS - 1) / half)
        place = jnp.clip(place, 0, 2**_BITS - 1).astype(jnp.int32)
        for mask, shift in ((0x030000FF, 16), (0x0300F00F, 8), (0x030C30C3, 4), (0x09249249, 2)):
            place = (place | place << shift) & mask
        code = code | place << axis
    return stable_order(code, jnp.int32(2 ** (3 * _BITS) - 1))
