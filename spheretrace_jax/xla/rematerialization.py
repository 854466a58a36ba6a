"""Rematerialization: what the reverse pass recomputes, and which residuals it stores."""

from collections.abc import Callable
from typing import TypeVar

import jax
from jax.ad_checkpoint import checkpoint_name

T = TypeVar("T")

_SAVED = "saved"


def save_residuals(values: T) -> T:
    """Marks small, expensive values for `remat` to store for the reverse pass."""
    return jax.tree.map(lambda value: checkpoint_name(value, _SAVED), values)


def remat(function: Callable[..., T]) -> Callable[..., T]:
    """Recomputes `function` in the reverse pass, except for values marked by `save_residuals`."""
    policy = jax.checkpoint_policies.save_only_these_names(_SAVED)
    return jax.checkpoint(function, policy=policy)
