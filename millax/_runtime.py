"""How JAX is set up for millax: double precision, and the faster of the codes that XLA makes for a processor."""

import os
import warnings

import jax
import numpy as np

XLA_FLAGS = (
    "--xla_cpu_prefer_vector_width=512",
    "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=100000000,xla_cpu_disable_loop_unrolling=true",
)
"""On a processor: the widest vectors it has, and the march through the tooth periods as one compiled loop, short loops in it
left as they are, instead of kernels that are dispatched one by one. Twice as fast, and more (`make bench`)."""


def set_up() -> None:
    """Set up JAX for millax, as its commands do. Call it before JAX computes anything.

    Double precision (`jax_enable_x64`), and XLA flags that make simulations on a processor two to three times as fast
    (`docs/speed.md`). What the user's XLA_FLAGS say already stays as it is. Warns where JAX has computed before, and the
    flags come too late. Importing millax does none of this: it is for a script of your own, in its first lines.
    """
    given = os.environ.get("XLA_FLAGS", "")
    new = [flag for flag in XLA_FLAGS if flag.split("=")[0] not in given]
    if new and _has_computed():
        warnings.warn("millax.set_up() comes too late for its XLA flags: JAX has computed already", stacklevel=2)
    else:
        os.environ["XLA_FLAGS"] = " ".join([*given.split(), *new])
    jax.config.update("jax_enable_x64", True)


def double_precision() -> bool:
    """Whether JAX computes in double precision here and now."""
    return jax.dtypes.canonicalize_dtype(float) == np.float64


def loops_are_compiled() -> bool:
    """Whether XLA makes one program of a loop, as after `set_up` on a processor, instead of dispatching its kernels one by
    one."""
    asked = "xla_cpu_small_while_loop_byte_threshold" in os.environ.get("XLA_FLAGS", "")
    return asked and jax.default_backend() == "cpu"


def _has_computed() -> bool:
    """Whether JAX has started its backends: it then refuses to change the number of devices."""
    devices = jax.config.values["jax_num_cpu_devices"]
    try:
        jax.config.update("jax_num_cpu_devices", devices + 1)
    except RuntimeError:
        return True
    jax.config.update("jax_num_cpu_devices", devices)
    return False
