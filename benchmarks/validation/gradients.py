"""Derivatives of force and displacement traces with respect to every parameter that a fit can vary."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import millax as mx

from ..figures import Figure, below
from ..slot import scaled, slot, traces

LEAVES = {
    "force.k0": lambda c: c.force.k0,
    "force.hs": lambda c: c.force.hs,
    "force.r": lambda c: c.force.r,
    "force.kr": lambda c: c.force.kr,
    "structure.mass": lambda c: c.structure.mass,
    "structure.stiffness": lambda c: c.structure.stiffness,
    "structure.damping_ratio": lambda c: c.structure.damping_ratio,
    "cut.spindle_speed": lambda c: c.cut.spindle_speed,
    "cut.feed_rate": lambda c: c.cut.feed_rate,
    "cut.depth": lambda c: c.cut.depth,
}
CHANGE = 1e-5
"""Largest change of the traces, of order 1, that a step of a central difference makes: small against their kinks."""


def figures():
    case = slot(duration=0.03, sweeps=8, tolerance=1e-13)

    @jax.jit
    def function(factors):
        return traces(scaled(case, lambda c: [leaf(c) for leaf in LEAVES.values()], list(factors)))

    one = jnp.ones(len(LEAVES))
    forward = jax.jit(jax.jacfwd(function))(one)
    weights = jax.random.normal(jax.random.key(0), (len(forward),))
    backward = jax.jit(jax.grad(lambda factors: function(factors) @ weights))(one)
    split = 2 * case.settings.steps
    for i, name in enumerate(LEAVES):
        column = np.asarray(forward[:, i])
        step = CHANGE / np.abs(column).max()
        difference = np.asarray(function(one.at[i].add(step)) - function(one.at[i].add(-step))) / (2 * step)
        for part, rows in (("force", slice(None, split)), ("displacement", slice(split, None))):
            error = np.abs(difference - column)[rows].max() / np.abs(column[rows]).max()
            yield below(f"{name}: {part} trace, forward mode beside central differences", error, 1e-6)
        reverse = abs(float(weights @ forward[:, i] - backward[i])) / float(jnp.abs(weights) @ jnp.abs(forward[:, i]))
        yield below(f"{name}: reverse mode beside forward mode", reverse, 1e-9)
    yield from _finite()


def _finite():
    for name, change in {
        "in contact": {},
        "out of contact": {"start": (-0.03, 0.0)},
        "zero feed, the surface at h = 0": {"feed": 0.0},
        "hard gates": {"width": 0.0},
        "zero feed, hard gates": {"feed": 0.0, "width": 0.0},
    }.items():
        case = slot(duration=0.0045, steps_per_tooth=20, sweeps=6, tolerance=1e-12, width=change.get("width", 1e-6))
        start = jnp.array(change.get("start", (-0.01, 0.0)))
        case = eqx.tree_at(lambda c: (c.cut.start, c.cut.feed_rate), case, (start, jnp.array(change.get("feed", 4 / 60))))
        numbers, rest = eqx.partition(case, eqx.is_inexact_array)

        def outputs(numbers, rest=rest):
            sim = mx.simulate(eqx.combine(numbers, rest), throw=False)
            return jnp.concatenate([sim.force.ravel(), sim.displacement.ravel(), sim.chip_thickness.ravel()])

        forward = jax.jvp(outputs, (numbers,), (jax.tree.map(jnp.ones_like, numbers),))
        backward = jax.grad(lambda n, outputs=outputs: jnp.sum(outputs(n)))(numbers)
        finite = all(bool(jnp.isfinite(leaf).all()) for leaf in jax.tree.leaves((forward, backward)))
        yield Figure(
            f"derivatives by every leaf of the case: {name}", "finite" if finite else "not finite", "finite", finite
        )
