"""Stopped derivatives: what a first derivative may take as constant, but a second one may not."""

from typing import TypeVar

import equinox as eqx
import jax
from jax.custom_derivatives import SymbolicZero
from jaxtyping import PyTree

T = TypeVar("T")


def stop_first_gradient(tree: T) -> T:
    """Returns `tree`, which the first derivative takes as constant and further ones do not.

    Where a function does not change to first order with a number that depends on its inputs, its
    derivative need not follow this number (envelope theorem). The derivative itself does change
    with the number, so that `lax.stop_gradient` would make second derivatives wrong.

    **Arguments:** `tree`: all inputs of the function. If the innermost derivative is by none of
    them, the next one counts as the first.
    """
    varying, other = eqx.partition(tree, eqx.is_inexact_array)
    return eqx.combine(_stop(varying), other)


@jax.custom_jvp
def _stop(tree: PyTree) -> PyTree:
    return tree


def _stop_jvp(primals: tuple[PyTree], tangents: tuple[PyTree]) -> tuple[PyTree, PyTree]:
    del tangents
    (tree,) = primals
    # the plain value: outer derivatives see through it
    return tree, jax.tree.map(SymbolicZero.from_primal_value, tree)


_stop.defjvp(_stop_jvp, symbolic_zeros=True)
