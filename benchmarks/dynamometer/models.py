"""What is fitted: force laws, the tool, the measuring chain; which of their numbers are free, and where they start."""

import dataclasses

import jax.numpy as jnp
import numpy as np

import millax as mx
from identification import Parameter, Prior, Tie

Free = list[Parameter | Tie]

STARTS = tuple((frequency, runout) for frequency in (1000.0, 2000.0) for runout in (-8e-6, -16e-6, -32e-6))
"""Frequencies of resonances [Hz] and runout [m]: a third, two thirds and four thirds of the smallest feed per tooth."""

MODES = 5
"""Of a coupled chain."""

FREQUENCY, DAMPING = (300.0, 4500.0), (0.01, 0.5)
"""Of a mode of the chain [Hz], [-]. One with less damping would still ring from the start of the simulation."""

OFFSETS = Prior(mean=0.0, std=10.0)
"""Of a charge amplifier that drifts [N]."""

RESIDUES = Prior(mean=0.0, std=1.0)
"""What is known of a coupled chain: its residues are of the order of the static gain, 1."""

STIFFNESS = 30e6
"""Of the tool in its spindle, at first [N/m]."""

SOFTEST_AND_STIFFEST = (4e6, 200e6)
"""Of the same. A softer tool with more runout makes much the same forces, on and on."""

TOOL = 1000.0
"""Frequency of its modes [Hz]. Not found: the forces hardly tell it, and the time steps do not resolve one far above."""


def laws(found: mx.LinearLaw) -> dict[str, tuple[mx.ForceLaw, list[Parameter]]]:
    """What the linear law is compared with, guessed near the one `found`, and what each has beside coefficients of each
    tooth."""
    kt, rest = found.kt, {name: getattr(found, name) for name in ("kr", "ka", "ke", "kre", "kae")}
    hs, m = 300e-6, 0.9
    bend = [Parameter("force.hs", bounds=("1 um", "1 mm")), Parameter("force.r", bounds=(0, 1))]
    return {  # both as large as the linear one at 50 um
        "exponential": (
            mx.ExponentialLaw(kf=kt * 50e-6 ** (1 - m), m=m, **rest),
            [Parameter("force.m", bounds=(0.05, 1))],
        ),
        "fractional": (mx.FractionalLaw(k0=kt * (1 + 50e-6 / hs), hs=hs, r=0.1, **rest), bend),
    }


def by_tooth(law: mx.ForceLaw, teeth: int = 2) -> tuple[mx.ForceLaw, list[Parameter]]:
    """The law with coefficients of each tooth, where it has none yet, and these as free parameters; what bends it stays one
    number."""
    names = [name for name in ("kt", "k0", "kf", "kr", "ka", "ke", "kre", "kae") if getattr(law, name, None) is not None]
    listed = {name: jnp.full(teeth, getattr(law, name)) for name in names}
    return dataclasses.replace(law, **listed), [Parameter(f"force.{name}.{i}") for name in names for i in range(teeth)]


def flexible_tool() -> tuple[mx.Structure, Free]:
    """A tool with one mode in each direction of the plane."""
    per_stiffness = 1 / (2 * np.pi * TOOL) ** 2
    stiffness = jnp.full(2, STIFFNESS)
    structure = mx.Structure(("x", "y"), per_stiffness * stiffness, stiffness, damping_ratio=jnp.full(2, 0.3))
    free: Free = []
    for axis in "xy":
        free += [
            Parameter(f"structure.stiffness.{axis}", bounds=SOFTEST_AND_STIFFEST),
            Parameter(f"structure.damping_ratio.{axis}", bounds=(0.01, 2.0)),
            Tie(f"structure.mass.{axis}", to=f"structure.stiffness.{axis}", factor=per_stiffness),
        ]
    return structure, free


OF_TRACES = [
    Parameter("tool.runout.1"),
    Parameter("clock.start", each=True),
    *[Parameter(f"sensor.bias.{axis}", each=True, prior=OFFSETS) for axis in "xyz"],
]


def fitted(of_law: list[Parameter], of_chain: list[Parameter]) -> Free:
    """All that is free: numbers of the law, the tool, the traces and the chain."""
    return [*of_law, *flexible_tool()[1], *OF_TRACES, *of_chain]


def per_axis(frequency: float) -> tuple[mx.Resonances, list[Parameter]]:
    """One resonance for each axis, and how much of it there is."""
    resonances = mx.Resonances.per_axis((frequency,) * 3, (0.05,) * 3)
    return resonances, _chain(3, [f"mode_{m}.{a}.{a}" for m, a in zip((1, 2, 3), "xyz", strict=True)], None)


def coupled() -> list[Parameter]:
    """What is free of modes that couple the axes."""
    names = [f"mode_{m + 1}.{a}.{b}" for m in range(MODES) for a in "xyz" for b in "xyz"]
    return _chain(MODES, names, RESIDUES)


def _chain(modes: int, residues: list[str], prior: Prior | None) -> list[Parameter]:
    numbered = range(1, modes + 1)
    return [
        *[Parameter(f"sensor.resonances.frequency.mode_{m}", bounds=FREQUENCY) for m in numbered],
        *[Parameter(f"sensor.resonances.damping_ratio.mode_{m}", bounds=DAMPING) for m in numbered],
        *[Parameter(f"sensor.resonances.residue.{name}", prior=prior) for name in residues],
    ]
