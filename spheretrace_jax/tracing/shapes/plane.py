"""The plane: everything that the tracer and the antialiasing must know of this shape.

Planes are infinite and seen from both sides. The back plane of a scene is one of them. A plane's
horizon is where D.N = 0: D.N takes the place of the sphere's distance |q| to the silhouette.
Arrays are scalars for one row of the tables, or one number per pixel once gathered.
"""

import equinox as eqx
import jax.numpy as jnp

from ...base.safe_math import larger, safe_sqrt
from ...base.types import Mask, PixelArray, Scalar
from ...base.vec import Vec, dot
from ...scene.camera import Ray
from ...scene.light import Light
from ..cone import RayCone
from ..differential import Differential
from ..hit import PixelCoverage, PixelHit, ShadowCoverage, ShadowedPixel, ShadowSegment, Surface

# D.N up to this many rounding errors is 0: the ray runs along the plane.
_LEAST_CROSSING = 4

# Near its horizon a plane is taken to be as steep as this part of what D.N varies in the pixel: a
# plane seen edge-on would else be infinitely far away.
_LEAST_SLOPE = 0.1


class Plane(eqx.Module):
    """The geometry of planes."""

    point: Vec  #: any point of the plane, world coordinates
    normal: Vec  #: of unit length

    def scaled(self, scale: Scalar) -> "Plane":
        """Returns the planes of a world that is `scale` times as large."""
        return Plane(self.point * scale, self.normal)

    # -- hits

    def closest_hit(
        self, ray: Ray, is_source: Mask | None, source_inside: Mask | None, may_be_inside: bool
    ) -> tuple[PixelArray, Mask | None]:
        """Returns the distance to the hit that a ray sees, and which rays skip the plane.

        **Arguments:** as for `Sphere.closest_hit`: a ray never meets the plane that it leaves.
        """
        del source_inside, may_be_inside
        return ray_plane(ray.origin, ray.direction, self.point, self.normal), is_source

    # -- surface

    def slope(self, ray: Ray) -> PixelArray:
        """Returns D.N: 0 where the ray runs along the plane, to the horizon."""
        return dot(ray.direction, self.normal)

    def offset(self, origin: Vec) -> PixelArray:
        """Returns the distance from points to the plane, positive on the side of -N."""
        return dot(self.point - origin, self.normal)

    def surface(self, ray: Ray, extent: PixelArray | None, is_plane: Mask) -> Surface:
        """Returns point and normal of a hit.

        **Arguments:** `extent`: how far D.N varies from the pixel's centre to its border, for the
        mean surface of the part of a pixel before the horizon; None for the hit of the ray itself.
        `is_plane`: true where the ray meets a plane; elsewhere numbers are finite and mean nothing.
        """
        slope, away = self.slope(ray), self.offset(ray.origin)
        if extent is not None:  # the mean of the slopes that meet the plane
            side = jnp.where(away < 0, -1, 1).astype(slope.dtype)
            low = larger(slope * side - extent, 0)
            slope = side * (low + larger(slope * side + extent, _LEAST_SLOPE * extent)) / 2
        crosses = _crosses(slope) & is_plane
        t = away / jnp.where(crosses, slope, 1)
        point = ray.origin + ray.direction * jnp.where(crosses, t, 0)
        if extent is not None:
            point = point + self.normal * self.offset(point)
        return Surface(
            point, self.normal * jnp.where(slope > 0, -1, 1).astype(slope.dtype), jnp.abs(slope)
        )

    # -- shadows

    def occludes(
        self, segment: ShadowSegment, is_own: Mask, own_inside: Mask, may_be_inside: bool
    ) -> Mask:
        """Tests whether the plane meets the open segments from points to a light.

        **Arguments:** as for `Sphere.occludes`.
        """
        del own_inside, may_be_inside
        point = dot(segment.point - self.point, self.normal)
        light = dot(segment.light.toward(self.point), self.normal)
        return (point * light < 0) & ~is_own

    def shadow_coverage(
        self, pixel: ShadowedPixel, is_own: Mask, own_inside: Mask, may_be_inside: bool
    ) -> ShadowCoverage:
        """Returns how much of a pixel the plane's shadow covers.

        **Arguments:** as for `Sphere.shadow_coverage`.
        """
        del own_inside, may_be_inside
        above = dot(pixel.light.toward(self.point), self.normal)
        f = pixel.point.map(lambda p: dot(p - self.point, self.normal))
        inner = jnp.where(above > 0, -f.value, f.value)
        across, down = pixel.spans
        extent = jnp.abs(f.dx) * across + jnp.abs(f.dy) * down
        other = ~is_own & (above != 0)
        all_dark, some_dark = (inner >= extent) & other, (inner > -extent) & other
        return ShadowCoverage(all_dark & (inner > 0), some_dark, inner > 0)

    def shadow_function(self, point: Differential[Vec], light: Light) -> Differential[PixelArray]:
        """Returns how far points are below the plane, seen from a light: positive in its shadow."""
        above = dot(light.toward(self.point), self.normal) > 0
        side = jnp.where(above, -1, 1).astype(point.value.x.dtype)
        return point.map(lambda p: dot(p - self.point, self.normal) * side)

    # -- edges

    def near_silhouette(self, ray: Ray, cone: RayCone, hit: PixelHit) -> Mask:
        """Tests whether the horizon may run through a pixel; any sphere that is hit hides it."""
        return (jnp.abs(self.slope(ray)) < cone.spread) & ~hit.is_sphere

    def near_crossing(self, ray: Ray, radius: PixelArray, steep: PixelArray, t: PixelArray) -> Mask:
        """Tests whether the plane may cut the surface hit.

        **Arguments:** as for `Sphere.near_crossing`.
        """
        slope = jnp.abs(self.slope(ray))
        apart = jnp.abs(ray_plane(ray.origin, ray.direction, self.point, self.normal) - t)
        return apart * slope < steep * slope + radius

    def near_shadow_edge(self, segment: ShadowSegment, radius: PixelArray) -> Mask:
        """Tests whether the surface may meet the plane in the pixel, where its shadow begins.

        **Arguments:** as for `Sphere.near_shadow_edge`.
        """
        return jnp.abs(dot(segment.point - self.point, self.normal)) < radius

    def pixel_coverage(
        self,
        ray: Differential[Ray],
        is_source: Mask,
        source_inside: Mask | None,
        may_be_inside: bool,
    ) -> PixelCoverage:
        """Returns how the plane covers pixels, for depth peeling.

        **Arguments:** as for `Sphere.pixel_coverage`.
        """
        del source_inside, may_be_inside
        slope = ray.map(lambda ray: self.slope(ray))
        away = self.offset(ray.value.origin)
        side = jnp.where(away < 0, -1, 1).astype(away.dtype)
        extent = (jnp.abs(slope.dx) + jnp.abs(slope.dy)) / 2
        toward = side * slope.value
        # parallel rays have no horizon: they cross the plane, or none of them does
        none = _LEAST_CROSSING * float(jnp.finfo(toward.dtype).eps)
        t = jnp.abs(away) / jnp.maximum(toward, jnp.where(extent > 0, _LEAST_SLOPE * extent, none))
        some = (toward > -extent) & (away != 0) & ~is_source
        return PixelCoverage(t, jnp.full(is_source.shape, False), some, toward >= extent)

    def horizon(self, ray: Differential[Ray]) -> tuple[Differential[PixelArray], PixelArray]:
        """Returns D.N, positive toward the plane, and how far D.N varies to the pixel's border."""
        away = self.offset(ray.value.origin)
        side = jnp.where(away < 0, -1, 1).astype(away.dtype)
        slope = ray.map(lambda ray: self.slope(ray) * side)
        return slope, safe_sqrt(slope.dx * slope.dx + slope.dy * slope.dy) / 2


def ray_plane(origin: Vec, direction: Vec, point: Vec, normal: Vec) -> PixelArray:
    """Intersects rays with a plane: returns `t`, negative behind, 0 where rays run along it.

    **Arguments:** `origin`, `direction`: rays, arrays of shape `(*pixels,)`, `direction` of unit
    length. `point`, `normal`: any point of the plane and its normal, of unit length.
    """
    slope = dot(direction, normal)
    crosses = _crosses(slope)
    return jnp.where(crosses, dot(point - origin, normal) / jnp.where(crosses, slope, 1), 0)


def _crosses(slope: PixelArray) -> Mask:
    """Tests whether rays cross a plane; D.N of the others is 0 within its rounding error.

    An eye in the plane would else see it at 0/0, with derivatives of 1e13 along the horizon.
    """
    return jnp.abs(slope) > _LEAST_CROSSING * float(jnp.finfo(slope.dtype).eps)
