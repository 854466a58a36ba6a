"""Runs the command line as `python -m spheretrace_jax.cli`."""

from .main import main

main()
