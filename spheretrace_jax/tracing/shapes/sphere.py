"""The sphere: everything that the tracer and the antialiasing must know of this shape.

A sphere is met where the perpendicular q from a ray to the centre is shorter than the radius; half
the chord h = sqrt(R^2 - q.q) gives both hits, the normal and N.V. Arrays are scalars for one row of
the tables, or one number per pixel once gathered.
"""

import equinox as eqx
import jax.numpy as jnp

from ...base.derivatives import stop_first_gradient
from ...base.safe_math import clamp, larger, safe_sqrt, smaller
from ...base.types import Mask, PixelArray, Scalar
from ...base.vec import Vec, cross, dot, norm
from ...scene.camera import Ray
from ...scene.light import Light
from ..cone import RayCone
from ..differential import Differential
from ..hit import PixelCoverage, PixelHit, ShadowCoverage, ShadowedPixel, ShadowSegment, Surface

# The largest h^2 in a pixel is taken to be at least this times R min(extent, R): a pixel that a rim
# only touches with its corner would have no normal otherwise.
_LEAST_RIM = 0.1

# The two points of Gauss and Legendre in 0..1, of equal weights. One point is 2 to 4 times as far
# off at a coat's rim (2.2e-2 instead of 1.3e-2 of a picture lit from the side).
_GAUSS = (0.5 - 0.75**0.5 / 3, 0.5 + 0.75**0.5 / 3)


class Sphere(eqx.Module):
    """The geometry of spheres."""

    center: Vec  #: world coordinates
    radius: PixelArray  #: > 0, world units

    def scaled(self, scale: Scalar) -> "Sphere":
        """Returns the spheres of a world that is `scale` times as large."""
        return Sphere(self.center * scale, self.radius * scale)

    def bounds(self) -> tuple[Vec, PixelArray]:
        """Returns centre and radius of the bounding spheres, for the accelerator."""
        return self.center, self.radius

    def perpendicular(self, ray: Ray) -> tuple[PixelArray, Vec]:
        """Returns how far along rays the centre is passed, and q; see `perpendicular`."""
        return perpendicular(ray.origin, ray.direction, self.center)

    # -- hits

    def intersect(self, ray: Ray) -> tuple[PixelArray, PixelArray]:
        """Returns the near and the far hit of rays; see `ray_sphere`."""
        return ray_sphere(ray.origin, ray.direction, self.center, self.radius)

    def closest_hit(
        self, ray: Ray, is_source: Mask | None, source_inside: Mask | None, may_be_inside: bool
    ) -> tuple[PixelArray, Mask | None]:
        """Returns the distance to the hit that a ray sees, and which rays skip the sphere.

        A ray that leaves a sphere outwards skips that sphere: spheres are convex. A ray mirrored
        on the inside meets the wall again at twice the way to the middle of the chord.

        **Arguments:** `is_source`: true where the ray starts on this sphere, None for the eye.
        `source_inside`: true where the ray starts on the inside of its source. `may_be_inside`:
        false where no ray of the scene starts inside a sphere.

        **Returns:** the distance, nan where the ray misses; the mask of rays that skip the sphere,
        None where none does.
        """
        near, far = self.intersect(ray)
        if not may_be_inside:
            return near, is_source
        t = jnp.where(near > 0, near, far)
        if is_source is None or source_inside is None:
            return t, None
        # computed from the middle: where rounding put the origin outside, rays along the wall
        # would pass it by
        along, _ = self.perpendicular(ray)
        return jnp.where(is_source & source_inside, 2 * along, t), is_source & ~source_inside

    def seen_from_inside(self, ray: Ray) -> Mask:
        """Tests whether the near hit lies behind the origin, so that the far one is seen."""
        near, _ = self.intersect(ray)
        return near <= 0

    # -- surface

    def surface(
        self, ray: Ray, q: Vec, half_chord: PixelArray, inside: Mask | None, curvature: PixelArray
    ) -> Surface:
        """Returns point and normal of a hit.

        Seen from the centre the hit point is w = -q - h D (from inside -q + h D): no root near
        zero is ever subtracted, so N = w/R is exact for the smallest and the largest sphere. It
        follows that N.V = h/R.

        **Arguments:** `q`, `half_chord`: those of `perpendicular` and `half_chord`, or their means
        over a pixel. `inside`: None where no ray meets a sphere from inside. `curvature`: 1/R.
        """
        cos_view = half_chord * curvature
        if inside is not None:
            half_chord = jnp.where(inside, -half_chord, half_chord)
            curvature = jnp.where(inside, -curvature, curvature)
        w = -q - ray.direction * half_chord
        return Surface(self.center + w, w * curvature, cos_view)

    def half_chord(self, q: Vec) -> PixelArray:
        """Returns h = sqrt(R^2 - q.q), half the chord of a ray; 0 where the ray misses."""
        return safe_sqrt(self.radius * self.radius - dot(q, q))

    def mean_chord(self, q: Vec, extent: PixelArray) -> tuple[PixelArray, Vec]:
        """Returns the means of the half chord and of q over the covered part of a pixel.

        **Arguments:** `extent`: how far |q| varies from the pixel's centre to its border.
        """
        square = dot(q, q)
        outer = safe_sqrt(square + extent * extent)
        shrink = smaller(self.radius / jnp.where(outer > 0, outer, 1), 1)
        half_chord = mean_root(*self.chord_range(q, extent))
        # the mean of unit normals is no longer than 1: highlights of a longer one explode
        length = safe_sqrt(square * shrink * shrink + half_chord * half_chord)
        short = smaller(self.radius / jnp.where(length > 0, length, 1), 1)
        return half_chord * short, q * (shrink * short)

    def chord_range(self, q: Vec, extent: PixelArray) -> tuple[PixelArray, PixelArray]:
        """Returns the least and the largest half chord over |q| +- extent inside the sphere."""
        length, square = norm(q), self.radius * self.radius
        near, far = larger(length - extent, 0), length + extent
        least_square = _LEAST_RIM * self.radius * smaller(extent, self.radius)
        largest = safe_sqrt(larger(square - near * near, least_square))
        return safe_sqrt(square - far * far), largest

    def mean_lambert(
        self, ray: Ray, q: Vec, extent: PixelArray, cosine: PixelArray, to_light: Vec
    ) -> tuple[PixelArray, Mask]:
        """Returns the mean of max(N.L, 0) over a pixel, and where N.L = 0 runs through its rim.

        Near the rim N.L depends on half the chord above all, and linearly: N = (-q - h D)/R.

        **Arguments:** `q`, `extent`: as for `mean_chord`. `cosine`: the mean of N.L. `to_light`: L.

        **Returns:** the mean, which holds only where the mask does.
        """
        radius = jnp.where(self.radius > 0, self.radius, 1)
        low, high = Sphere(self.center, radius).chord_range(q, extent)
        slope = -dot(ray.direction, to_light) / radius
        h = mean_root(low, high) - cosine / jnp.where(slope == 0, 1, slope)
        # the integrand vanishes at N.L = 0, so that moving this end changes nothing to first order
        zero = clamp(*stop_first_gradient((h, low, high)))
        start, end = jnp.where(slope > 0, zero, low), jnp.where(slope > 0, high, zero)
        interval = high * high - low * low
        mixed = (low < zero) & (zero < high) & (slope != 0)
        lit = (end * end - start * start) / jnp.where(mixed, interval, 1)
        return lit * (cosine + slope * (mean_root(start, end) - mean_root(low, high))), mixed

    def rim_cosines(
        self, ray: Ray, q: Vec, extent: PixelArray, cosine: PixelArray, to_light: Vec
    ) -> list[tuple[PixelArray, PixelArray]]:
        """Returns N.L and N.V of points that stand for equal parts of what a pixel shows.

        N.L depends on half the chord h as in `mean_lambert`; the points are those of Gauss and
        Legendre in h^2, over which the area is spread evenly.

        **Arguments:** as for `mean_lambert`.
        """
        radius = jnp.where(self.radius > 0, self.radius, 1)
        low, high = Sphere(self.center, radius).chord_range(q, extent)
        slope, mean = -dot(ray.direction, to_light) / radius, mean_root(low, high)
        least, interval = low * low, high * high - low * low
        chords = [safe_sqrt(least + interval * place) for place in _GAUSS]
        return [(cosine + slope * (h - mean), h / radius) for h in chords]

    # -- shadows

    def occludes(
        self, segment: ShadowSegment, is_own: Mask, own_inside: Mask, may_be_inside: bool
    ) -> Mask:
        """Tests whether the sphere meets the open segments from points to a light.

        The form with the cross product needs no division and no root, either of which would split
        the loop into several kernels: |PC x PL|^2 = |PC|^2 |PL|^2 sin^2. It multiplies four
        lengths: see `queries.shadow_scale`. `shadow_coverage` is the form for whole pixels.

        **Arguments:** `is_own`: true where the point lies on this sphere. `own_inside`: true where
        a point lies on the inside of its sphere. `may_be_inside`: as for `closest_hit`.
        """
        to_center = self.center - segment.point
        off = cross(to_center, segment.to_light)
        square_radius = self.radius * self.radius
        close = dot(off, off) < square_radius * segment.square
        along = dot(to_center, segment.to_light)
        light_inside = segment.light.within(self.center, square_radius)
        between = (along > 0) & segment.ends_after(along)
        if not may_be_inside:
            return close & (between | light_inside) & ~is_own
        inside = jnp.where(is_own, own_inside, dot(to_center, to_center) < square_radius)
        within = inside | light_inside
        return jnp.where(within, inside != light_inside, close & between & ~is_own)

    def shadow_coverage(
        self, pixel: ShadowedPixel, is_own: Mask, own_inside: Mask, may_be_inside: bool
    ) -> ShadowCoverage:
        """Returns how much of a pixel the sphere's shadow covers; says the same as `occludes` where
        no shadow edge runs through the pixel.

        **Arguments:** as for `occludes`.
        """
        foot = pixel.point.map(lambda p: from_light(p, pixel.light, self.center))
        along, q = foot.value
        extent, inner = pixel.corner_extent(foot.dx[1], foot.dy[1]), self.radius - norm(q)
        to_center = self.center - pixel.point.value
        light_inside = pixel.light.within(self.center, self.radius * self.radius)
        between = (along > 0) & (along < pixel.light_distance)
        if not may_be_inside:
            between = (between | light_inside) & ~is_own
            all_dark = (inner >= extent) & between
            return ShadowCoverage(all_dark, (inner > -extent) & between, inner > 0)
        # a mean point may lie a little inside a sphere that cuts the surface in this pixel
        deep = jnp.maximum(self.radius - pixel.footprint, 0)
        inside = jnp.where(is_own, own_inside, dot(to_center, to_center) < deep * deep)
        within = inside | light_inside
        all_dark = jnp.where(within, inside != light_inside, (inner >= extent) & between & ~is_own)
        some_dark = jnp.where(within, all_dark, (inner > -extent) & between & ~is_own)
        return ShadowCoverage(all_dark, some_dark, inner > 0)

    # -- edges

    def near_silhouette(self, ray: Ray, cone: RayCone, hit: PixelHit) -> Mask:
        """Tests whether the silhouette may run through a pixel.

        None shows where a closer object is hit, nor of the sphere that the ray just left.
        """
        along, q = self.perpendicular(ray)
        near = _between(dot(q, q), self.radius, cone.radius_at(along), 1) & (along > 0)
        near = near & ~(hit.is_other & (hit.t < along))
        return near if hit.is_source is None else near & ~hit.is_source

    def near_crossing(self, ray: Ray, radius: PixelArray, steep: PixelArray, t: PixelArray) -> Mask:
        """Tests whether the sphere may cut the surface hit: both are equally deep in the pixel.

        **Arguments:** `radius`: that of the ray's cone at the hit. `steep`: how much the depth
        of the surface hit varies across the pixel. `t`: its depth.
        """
        along, q = self.perpendicular(ray)
        half = jnp.sqrt(self.radius * self.radius - dot(q, q))  # nan = miss
        apart = jnp.minimum(jnp.abs(along - half - t), jnp.abs(along + half - t))
        # near its rim a sphere's depth varies as a root does: by no more than R and the pixel
        near = apart < steep + self.radius + radius
        return near & (apart * half < steep * half + radius * norm(q))

    def near_shadow_edge(self, segment: ShadowSegment, radius: PixelArray) -> Mask:
        """Tests whether the edge of the sphere's shadow may run through a pixel.

        **Arguments:** `radius`: that of the pixel's footprint on the surface.
        """
        to_center = self.center - segment.point
        off = cross(to_center, segment.to_light)
        along = dot(to_center, segment.to_light)
        width = segment.narrowed(radius, along)
        near = _between(dot(off, off), self.radius, width, segment.square)
        return near & (along > 0) & segment.ends_after(along)

    def pixel_coverage(
        self,
        ray: Differential[Ray],
        is_source: Mask,
        source_inside: Mask | None,
        may_be_inside: bool,
    ) -> PixelCoverage:
        """Returns how the sphere covers pixels, for depth peeling.

        **Arguments:** as for `closest_hit`; `source_inside`: None for rays from the eye.
        """
        foot = ray.map(lambda ray: self.perpendicular(ray))
        along, q = foot.value
        extent, length = (norm(foot.dx[1]) + norm(foot.dy[1])) / 2, norm(q)
        square = self.radius * self.radius - dot(q, q)
        half_chord = safe_sqrt(square)
        t, inside = along - half_chord, jnp.full(is_source.shape, False)
        some, all_ = length < self.radius + extent, length + extent <= self.radius
        if not may_be_inside:
            return PixelCoverage(t, inside, some & ~is_source, all_)
        inside = (t <= 0) & (square > 0)
        if source_inside is not None:
            some, inside = some & (~is_source | source_inside), inside | is_source
        t = jnp.where(inside, along + half_chord, t)
        return PixelCoverage(t, inside, some, all_ | inside)


def perpendicular(origin: Vec, direction: Vec, center: Vec) -> tuple[PixelArray, Vec]:
    """Returns where rays pass a point, and the vector from there to the point.

    **Arguments:** `origin`, `direction`: rays, `direction` of unit length. `center`: the point.

    **Returns:** `along`, the distance from the origin to the foot of the perpendicular, negative
    behind the origin; `q`, from the foot to `center`. World units.
    """
    oc = center - origin
    along = dot(oc, direction)
    return along, oc - direction * along


def from_light(point: Vec, light: Light, center: Vec) -> tuple[PixelArray, Vec]:
    """Returns where the segment from a point to a light passes a centre; see `perpendicular`."""
    return perpendicular(point, light.direction(point), center)


def ray_sphere(
    origin: Vec, direction: Vec, center: Vec, radius: PixelArray
) -> tuple[PixelArray, PixelArray]:
    """Intersects rays with one sphere.

    The lecture solves A t^2 + B t + C = 0 with A = d.d, B = 2 d.(o - c), C = |o - c|^2 - R^2
    (slides "Computing Coefficients", "Solving the Equation"): two roots where the discriminant
    B^2 - 4AC is positive, one where it is 0 (the ray is tangent), none where it is negative. In
    float32 B^2 - 4AC cancels for small or distant spheres, so a quarter of it is taken as
    R^2 - q.q, from the perpendicular q from the ray to the centre (Haines, Guenther,
    Akenine-Moeller, "Precision Improvements for Ray/Sphere Intersection", Ray Tracing Gems, 2019,
    ch. 7).

    **Arguments:** `origin`, `direction`: rays, arrays of shape `(*pixels,)`, world units;
    `direction` of unit length. `center`, `radius`: the sphere, world units, radius > 0.

    **Returns:** the near and the far `t` along the ray, world units: equal where the ray is
    tangent, `nan` where it misses, near negative and far positive where the ray starts inside.
    """
    along, q = perpendicular(origin, direction, center)
    half_chord = jnp.sqrt(radius * radius - dot(q, q))  # nan = miss: no comparison with it holds
    return along - half_chord, along + half_chord


def mean_root(low: PixelArray, high: PixelArray) -> PixelArray:
    """Returns the mean of a number whose square is spread evenly from low^2 to high^2.

    Half the chord over a disc is such a number, the root of R^2 - q.q.
    """
    both = jnp.where(low + high > 0, low + high, 1)
    return (low * low + low * high + high * high) / both * (2 / 3)


def _between(
    square: PixelArray, radius: PixelArray, width: PixelArray, scale: PixelArray | int
) -> Mask:
    """Tests whether a distance, given by its square over `scale`, is within `width` of a radius."""
    inner, outer = radius - width, radius + width
    return (square < outer * outer * scale) & ((inner < 0) | (square > inner * inner * scale))
