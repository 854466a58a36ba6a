"""The device that JAX computes on."""

import functools

import jax

from .errors import InputError


@functools.cache
def check_device() -> None:
    """Checks that JAX has a device: without one it fails in the middle of its own code.

    **Raises:** `InputError` where JAX is told to use a platform that this machine does not have.
    """
    try:
        jax.default_backend()
    except (AssertionError, RuntimeError):  # JAX 0.10 says nothing where CUDA is missing
        platforms = getattr(jax.config, "jax_platforms", None)
        raise InputError(
            f"JAX finds no device: JAX_PLATFORMS is {platforms!r}, which this machine or this "
            "installation of JAX does not have; unset JAX_PLATFORMS, or set it to cpu"
        ) from None
