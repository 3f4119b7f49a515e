"""The papers' slot: KR240, aluminium, 10 000 rpm, 4 m/min, 4 teeth, entering a straight border at t = 0."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

import millax as mx

SPEED = 10000 * 2 * np.pi / 60
FEED = 4 / 60


def slot(
    *,
    axes=("x", "y"),
    mass=100.0,
    stiffness=3e5,
    damping_ratio=0.05,
    duration=1.0,
    border=True,
    diameter=0.02,
    **settings,
) -> mx.Case:
    tool = mx.EndMill(diameter, 4)
    law = mx.FractionalLaw(k0=5e9, hs=18e-6, r=0.1, kr=0.3)
    cut = mx.Cut.touching(tool, SPEED, FEED, 1e-3)
    structure = mx.Structure(axes, mass, stiffness, damping_ratio=damping_ratio) if axes else mx.Structure.rigid()
    stock = mx.Stock.box() if border else mx.Stock.box((None, None))
    numerics = mx.Settings.suited(tool, law, structure, cut, duration, **settings)
    return mx.Case(tool, law, cut, stock, structure, numerics)


def scaled(case: mx.Case, where, factors):
    """`case` with the leaves that `where` selects multiplied by `factors`."""
    return eqx.tree_at(where, case, [leaf * factor for leaf, factor in zip(where(case), factors, strict=True)])


def traces(case: mx.Case, force_unit=100.0, displacement_unit=1e-5):
    """Force and displacement as one vector of numbers of order 1."""
    sim = mx.simulate(case, throw=False)
    return jnp.concatenate([sim.force[:, :2].ravel() / force_unit, sim.displacement.ravel() / displacement_unit])
