"""Peak memory of derivatives of a long trace, each in a process of its own."""

from ..figures import Figure, below
from .child import ask
from .run import Run

MB = 1e6
SHORT = 0.1
"""A run whose traces are negligible [s]: Python, JAX and the compiler."""


def figures(run: Run):
    reverse = ask("reverse", run.minute)
    what = f"{run.minute:g} s, {reverse['steps'] / 1e6:.2g} million steps"
    yield below(f"reverse-mode gradient, {what}: peak of the process", reverse["peak"] / MB, 1000, form=".0f", unit=" MB")
    for mode, how in (("rows", "jax.lax.map over directions"), ("forward", "jax.jacfwd")):
        whole, short = ask(mode, run.minute), ask(mode, min(SHORT, run.minute))
        outputs, above = whole["result"] / MB, (whole["peak"] - short["peak"]) / MB
        name = f"Jacobian, 6 parameters, {how}"
        yield Figure(f"{name}: size of the result", f"{outputs:.0f} MB", "", None)
        yield Figure(f"{name}: time", f"{whole['seconds']:.2g} s", "", None)
        yield below(f"{name}: peak above that of a short trace", above, outputs + 100, form=".0f", unit=" MB")
