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
    forward, short = ask("forward", run.minute), ask("forward", min(SHORT, run.minute))
    outputs = forward["result"] / MB
    above = (forward["peak"] - short["peak"]) / MB
    yield Figure(f"Jacobian, 6 parameters, {what}: size of the result", f"{outputs:.0f} MB", "", None)
    yield Figure("the same over a short trace: peak of the process", f"{short['peak'] / MB:.0f} MB", "", None)
    yield below("Jacobian: peak above that of the short trace", above, outputs + 100, form=".0f", unit=" MB")
