"""Rematerialisation: what the reverse pass computes again, and what it keeps."""

from collections.abc import Callable
from typing import TypeVar

import jax
import jax.core
from jax.ad_checkpoint import checkpoint_name

T = TypeVar("T")


def save_residuals(values: T) -> T:
    """The same values, which `retrace` remembers: small ones that took long to find."""
    return jax.tree.map(lambda value: checkpoint_name(value, _REMEMBERED), values)


def remat(function: Callable[..., T]) -> Callable[..., T]:
    """The same function, computed again in the reverse pass but for what it remembers."""
    policy = jax.checkpoint_policies.save_only_these_names(_REMEMBERED)
    return jax.checkpoint(function, policy=policy)


_REMEMBERED = "remembered"
