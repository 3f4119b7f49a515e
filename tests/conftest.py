"""Tests run in float64, as the command line does, and leave the user's compilation cache alone."""

import os

os.environ.setdefault("JAX_ENABLE_COMPILATION_CACHE", "false")

import jax

jax.config.update("jax_enable_x64", True)
