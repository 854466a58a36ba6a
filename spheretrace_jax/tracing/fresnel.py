"""Fresnel's equations: what a smooth transparent coat reflects, and what it lets through."""

import jax.numpy as jnp

from ..base.types import PixelArray


def fresnel(cosine: PixelArray, ior: PixelArray) -> PixelArray:
    """Returns F, the part of unpolarised light that the surface of a dielectric reflects.

    Fresnel's equations for light from outside, with c the cosine of the angle of incidence and n
    the index of refraction (Born, Wolf, Principles of Optics, 7th ed., 1999, 1.5; in this form
    Cook, Torrance, A Reflectance Model for Computer Graphics, ACM TOG 1(1), 1982):

        F = (r_s^2 + r_p^2)/2,  r_s = (c - g)/(c + g),  r_p = (n^2 c - g)/(n^2 c + g),
        g^2 = n^2 - 1 + c^2

    Both numerators are multiplied by their denominators, which leaves n^2 - 1 as a factor. So F and
    its derivative by n are exactly 0 where n = 1, and nothing cancels near it.

    **Arguments:** `cosine`: in 0..1; negative ones count as 0. `ior`: n, at least 1.

    **Returns:** F in 0..1: 1 where c = 0 and n > 1, 0 where n = 1, also for c = 0.
    """
    c = jnp.where(cosine < 0, 0, cosine)
    excess, n2 = (ior - 1) * (ior + 1), ior * ior
    square = excess + c * c
    # g^2 is so small only where n = 1: fourth powers of 1/c, in second derivatives, would overflow
    defined = square > float(jnp.finfo(square.dtype).tiny) ** 0.5
    g = jnp.sqrt(jnp.where(defined, square, 1))
    s, p = 1 / (c + g), 1 / (n2 * c + g)
    r_s, r_p = excess * s * s, excess * ((n2 + 1) * (c * c) - 1) * p * p
    return jnp.where(defined, (r_s * r_s + r_p * r_p) / 2, 0)


def coat_transmission(cosine: PixelArray, cos_view: PixelArray, ior: PixelArray) -> PixelArray:
    """Returns (1 - F(N.L)) (1 - F(N.V)): what of the diffuse light a coat lets in, and out again.

    Light enters the coat from L, is scattered in all directions below, and leaves toward V (Wolff,
    Diffuse-reflectance model for smooth dielectric surfaces, JOSA A 11(11), 1994). Leaving at the
    refracted angle lets through as much as entering along V. What the coat reflects back inside
    depends on no direction: it belongs to kd.

    **Arguments:** `cosine`: N.L. `cos_view`: N.V. `ior`: at least 1; 1 gives exactly 1.
    """
    return (1 - fresnel(cosine, ior)) * (1 - fresnel(cos_view, ior))
