"""The lecture's shading: ambient, Lambert and Phong (or Blinn's halfway-vector) terms at a point.

    C = ka A S + sum over lights l of  lit_l C_l f_l (kd (N.L_l) S + ks highlight_l)

with S the surface's colour, C_l the light's, A the mean of all C_l, and unit vectors N, L, V, R, H.
f_l is 1, or (falloff / r)^2 of a light that grows dimmer with its distance r. Beyond the lecture,
an object may have a coat, which dims N.L_l (`fresnel.py`).
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax.numpy as jnp

from ..base.types import Highlight, Mask, PixelArray
from ..base.vec import Vec, dot, norm
from ..scene.light import Light
from .fresnel import coat_transmission
from .hit import Surface


def lambert(surface: Surface, to_light: Vec) -> PixelArray:
    """Returns N.L; negative values mean unlit. **Arguments:** `to_light`: unit vectors L."""
    return dot(surface.normal, to_light)


def phong(surface: Surface, to_light: Vec, direction: Vec) -> PixelArray:
    """Returns R.V with R = 2 (N.L) N - L (slide "Specular Reflection"), which may be negative.

    **Arguments:** `to_light`: unit vectors L. `direction`: the rays' directions, -V.
    """
    return 2 * lambert(surface, to_light) * surface.cos_view + dot(to_light, direction)


def blinn(surface: Surface, to_light: Vec, direction: Vec) -> PixelArray:
    """Returns H.N with H = (L + V)/|L + V| (slide "Halfway Vector").

    The value is 0 where L = -V leaves H undefined.

    **Arguments:** as for `phong`.
    """
    length = norm(to_light - direction)
    defined = length > 0
    cosine = (lambert(surface, to_light) + surface.cos_view) / jnp.where(defined, length, 1)
    return jnp.where(defined, cosine, 0)


class HighlightModel(NamedTuple):
    """A model of highlights: max(cosine, 0)^exponent where the surface is lit."""

    cosine: Callable[[Surface, Vec, Vec], PixelArray]  #: a function such as `phong`
    #: from L and the rays' directions to where the highlight has not faded out at N.L = 0, where
    #: lighting ends: an edge
    ends_abruptly: Callable[[Vec, Vec], Mask]


#: All models; their names are those of `base.types.Highlight`.
HIGHLIGHTS: dict[Highlight, HighlightModel] = {
    # R.V is positive at N.L = 0 only where L.V < 0, with the light behind the surface
    "phong": HighlightModel(phong, lambda L, direction: dot(L, direction) > 0),
    "blinn": HighlightModel(blinn, lambda L, _: jnp.full(L.x.shape, True)),
}


def power(cosine: PixelArray, exponent: PixelArray) -> PixelArray:
    """Returns max(cosine, 0)^exponent, with 0^0 = 1; the derivative is 0 where cosine <= 0."""
    positive = cosine > 0
    # exp(n log c): 1.5 ms for a million pixels, where `jnp.power` takes 5.1
    value = jnp.exp(exponent * jnp.log(jnp.where(positive, cosine, 1)))
    return jnp.where(positive, value, jnp.where(exponent == 0, 1, 0).astype(cosine.dtype))


class Finish(NamedTuple):
    """The numbers of a material that shape its terms, where the picture needs them."""

    exponent: PixelArray | None  #: of the highlight; None without highlights
    ior: PixelArray | None  #: of the coat; None where no object has one


def light_terms(
    surface: Surface,
    direction: Vec,
    light: Light,
    finish: Finish,
    lit: Mask,
    highlight: Highlight | None,
) -> tuple[PixelArray, PixelArray]:
    """Computes one light's terms before colours and coefficients: N.L and (R.V)^n, 0 if unlit.

    Under a coat the first one is N.L (1 - F(N.L)) (1 - F(N.V)). Both are multiplied by the light's
    fall-off.

    **Arguments:** `direction`: the rays' directions. `lit`: whether the light is visible from the
    point. `highlight`: the model; None leaves the second term out.
    """
    to_light = light.direction(surface.point)
    cosine = lambert(surface, to_light)
    lit = lit & (cosine > 0)
    diffuse = cosine
    if finish.ior is not None:
        diffuse = cosine * coat_transmission(cosine, surface.cos_view, finish.ior)
    diffuse = jnp.where(lit, diffuse, 0)
    faded = partial(light.faded, surface.point)
    if highlight is None or finish.exponent is None:
        return faded(diffuse), jnp.zeros_like(diffuse)
    shine = power(HIGHLIGHTS[highlight].cosine(surface, to_light, direction), finish.exponent)
    return faded(diffuse), faded(jnp.where(lit, shine, 0))
