"""Hits and surfaces: the discrete and the smooth half of what a ray meets."""

import equinox as eqx
import jax.numpy as jnp

from ..base.types import Ids, Mask, PixelArray
from ..base.vec import Vec, dot, norm
from ..scene.light import Light
from .differential import Differential


class Hit(eqx.Module):
    """The discrete half of what a ray meets; integers and booleans have no derivative."""

    id: Ids  #: the object's number, -1 for none
    inside: Mask  #: true of a sphere that is seen from inside


class Surface(eqx.Module):
    """The smooth half of what a ray meets: differentiable in the scene."""

    point: Vec  #: P
    normal: Vec  #: N, of unit length, turned to the viewer
    cos_view: PixelArray  #: N.V, at least 0


class ShadowSegment(eqx.Module):
    """The open segments from surface points to one light."""

    point: Vec  #: P
    light: Light
    to_light: Vec  #: light - P; the unit vector toward a directional light
    square: PixelArray  #: |to_light|^2

    def ends_after(self, along: PixelArray) -> Mask | bool:
        """Tests whether the light lies behind points of the segments' lines.

        **Arguments:** `along`: from P to these points, times to_light.
        """
        return True if self.light.directional else along < self.square

    def narrowed(self, radius: PixelArray, along: PixelArray) -> PixelArray:
        """Returns how wide a ball around P is at points of the segments, seen from the light.

        **Arguments:** `along`: as for `ends_after`.
        """
        return radius if self.light.directional else radius - along * (radius / self.square)


def shadow_segment(point: Vec, light: Light) -> ShadowSegment:
    """Returns the segments from surface points to a light; rays if that is infinitely far away."""
    to_light = light.toward(point)
    return ShadowSegment(point, light, to_light, dot(to_light, to_light))


class PixelHit(eqx.Module):
    """The hit of a pixel's ray, beside an object whose silhouette may run through the pixel."""

    t: PixelArray  #: the distance to the hit, infinite where there is none
    is_other: Mask  #: true where another object is hit, or none
    is_sphere: Mask  #: true where a sphere is hit
    is_source: Mask | None  #: true where the ray starts on the object; None for the eye


class PixelCoverage(eqx.Module):
    """How one object covers pixels, as far as depth peeling asks."""

    t: PixelArray  #: depth along the ray, world units
    inside: Mask  #: true where the object is a sphere seen from inside
    some: Mask  #: true where the object covers at least a part of the pixel
    all: Mask  #: true where the object covers the whole pixel


class ShadowCoverage(eqx.Module):
    """How the shadow of one object covers pixels, as far as shadow edges ask."""

    all: Mask  #: true where the whole pixel is dark
    some: Mask  #: true where at least a part of the pixel is dark
    #: true where the middle of what is seen is dark, if a part of the pixel is, but not all of it
    center: Mask


class ShadowedPixel(eqx.Module):
    """The visible part of a surface in pixels, and the light whose shadows are looked for."""

    point: Differential[Vec]  #: the surface at the middle of what is visible, with derivatives
    middle: tuple[PixelArray, PixelArray]  #: that middle, pixels right and down of the centre
    light: Light
    light_distance: PixelArray  #: from the point to the light, which may be infinite

    @property
    def footprint(self) -> PixelArray:
        """Returns how far the surface point moves in the pixel at most."""
        return self.corner_extent(self.point.dx, self.point.dy)

    def corner_extent(self, dx: Vec, dy: Vec) -> PixelArray:
        """Returns how far a vector varies at most between the middle and the pixel's corners.

        **Arguments:** `dx`, `dy`: the vector's derivatives by the position in pixels.
        """
        across, down = self.spans
        return norm(dx) * across + norm(dy) * down

    @property
    def spans(self) -> tuple[PixelArray, PixelArray]:
        """Returns the largest distances, across and down, from the middle to the pixel's border."""
        return 0.5 + jnp.abs(self.middle[0]), 0.5 + jnp.abs(self.middle[1])
