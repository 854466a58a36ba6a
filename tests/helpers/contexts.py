"""Contexts in which tests trace single rays."""

import spheretrace_jax as st
from spheretrace_jax.scene.settings import render_settings
from spheretrace_jax.tracing.context import TraceContext, build_context


def context_of(
    scene: st.Scene,
    needs: st.Needs | None = None,
    size: tuple[int, int] = (8, 8),
    bounces: int = 0,
    accelerated: bool = False,
) -> TraceContext:
    """Builds the context of a picture of `size` (width, height); by default it needs everything."""
    needs = st.Needs() if needs is None else needs
    settings = render_settings(scene, *size, bounces=bounces, needs=needs)
    return build_context(scene, settings, accelerated)
