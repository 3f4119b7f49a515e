"""Derivatives of the traces: forward = reverse = central differences, and finite where the model has kinks."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import ENDLESS, slot

import millax as mx
from millax import _march

LEAVES = {
    "force.k0": lambda c: c.force.k0,
    "force.hs": lambda c: c.force.hs,
    "force.r": lambda c: c.force.r,
    "force.kr": lambda c: c.force.kr,
    "structure.mass.x": lambda c: c.structure.mass,
    "structure.stiffness": lambda c: c.structure.stiffness,
    "structure.damping_ratio": lambda c: c.structure.damping_ratio,
    "cut.spindle_speed": lambda c: c.cut.spindle_speed,
    "cut.feed_rate": lambda c: c.cut.feed_rate,
    "cut.depth": lambda c: c.cut.depth,
    "tool.diameter": lambda c: c.tool.diameter,
}


def traces(case):
    """Force and displacement, each over its own size."""
    sim = mx.simulate(case, throw=False)
    return jnp.concatenate([sim.force[:, :2].ravel() / 100, sim.displacement.ravel() / 1e-5])


def varied(case, names, factors):
    """`case` with the leaves of these names multiplied by `factors`."""
    where = [LEAVES[name] for name in names]
    new = [leaf(case) * factor for leaf, factor in zip(where, factors, strict=True)]
    return eqx.tree_at(lambda c: [leaf(c) for leaf in where], case, new)


@pytest.fixture(scope="module")
def routes():
    """Traces as a function of factors on all leaves, their Jacobian forwards, and a random projection of it backwards."""
    case = slot(duration=0.015, sweeps=7)

    def scaled(factors):
        return traces(varied(case, LEAVES, factors))

    one = jnp.ones(len(LEAVES))
    forward = jax.jit(jax.jacfwd(scaled))(one)
    weights = jax.random.normal(jax.random.key(0), (len(forward),))
    backward = jax.jit(jax.grad(lambda factors: scaled(factors) @ weights))(one)
    return jax.jit(scaled), one, forward, weights, backward


def test_reverse_mode_agrees_with_forward_mode(routes):
    _, _, forward, weights, backward = routes
    assert np.allclose(weights @ forward, backward, rtol=1e-9)


@pytest.mark.parametrize("index", range(len(LEAVES)), ids=LEAVES.keys())
def test_forward_mode_agrees_with_central_differences(routes, index):
    scaled, one, forward, _, _ = routes
    column = forward[:, index]
    assert np.abs(column).max() > 1e-2
    step = 1e-5 / np.abs(column).max()  # small against the curvature of the traces, large against their rounding
    difference = (scaled(one.at[index].add(step)) - scaled(one.at[index].add(-step))) / (2 * step)
    assert np.abs(difference - column).max() < 1e-6 * np.abs(column).max()


@pytest.mark.parametrize("law", ["linear", "exponential", pytest.param("fractional", marks=pytest.mark.long)])
def test_every_law_both_routes(law):
    force = {
        "linear": mx.LinearLaw(kt=8e8, kr=0.3, ke=1e4),
        "exponential": mx.ExponentialLaw(kf=1e6, m=0.7, kr=0.3),
        "fractional": mx.FractionalLaw(5e9, 18e-6, 0.1, 0.3),
    }[law]
    case = slot(force=force, duration=0.006, sweeps=6, stock=ENDLESS)

    @jax.jit
    @jax.value_and_grad
    def projected(force):
        return traces(eqx.tree_at(lambda c: c.force, case, force)) @ weights

    weights = jax.random.normal(jax.random.key(1), jax.eval_shape(traces, case).shape)
    _, gradient = projected(force)
    for name in ("kt", "ke", "kf", "m", "k0", "hs", "r", "kr"):
        value = getattr(force, name, None)
        if value is not None:
            up, down = (eqx.tree_at(lambda f, n=name: getattr(f, n), force, value * (1 + s)) for s in (1e-6, -1e-6))
            difference = (projected(up)[0] - projected(down)[0]) / (2e-6 * value)
            assert float(difference) == pytest.approx(float(getattr(gradient, name)), rel=1e-5)


@pytest.mark.long
def test_simulations_in_several_stretches_have_the_same_derivatives(monkeypatch):
    # 20 periods in stretches of at most 7: the reverse derivative starts from a checkpoint in each.
    case = slot(duration=0.03, steps_per_tooth=20, sweeps=3)
    assert case.settings.periods == 20
    names = ("force.k0", "structure.stiffness", "cut.spindle_speed")
    weights = jax.random.normal(jax.random.key(2), (20 * 20 * 9,))

    def outputs(factors):
        sim = mx.simulate(varied(case, names, factors), throw=False)
        return jnp.concatenate([sim.force.ravel() / 100, sim.displacement.ravel() / 1e-5, sim.chip_thickness.ravel() / 1e-4])

    one = jnp.ones(len(names))
    whole, forward = outputs(one), jax.jit(jax.jacfwd(outputs))(one)
    monkeypatch.setattr(_march, "STRETCH", 7)
    jax.clear_caches()
    in_stretches = outputs(one), jax.jit(jax.jacfwd(outputs))(one)
    backward = jax.jit(jax.grad(lambda factors: outputs(factors) @ weights))(one)
    jax.clear_caches()
    for ours, theirs in zip(in_stretches, (whole, forward), strict=True):
        assert np.abs(theirs).max() > 0
        assert np.abs(ours - theirs).max() <= 1e-11 * np.abs(theirs).max()
    assert np.allclose(backward, weights @ forward, rtol=1e-9)


@pytest.mark.long
def test_second_derivatives_are_those_of_the_gradient():
    # Of a weighted sum of all traces.
    case = slot(duration=0.0045, steps_per_tooth=20, sweeps=6, stock=ENDLESS)
    names = ("force.k0", "force.hs", "force.kr", "structure.stiffness")
    weights = jax.random.normal(jax.random.key(3), (3 * 20 * 4,))
    gradient = jax.jit(jax.grad(lambda factors: traces(varied(case, names, factors)) @ weights))
    one, step = jnp.ones(len(names)), 1e-4
    second = jax.jit(lambda direction: jax.jvp(gradient, (one,), (direction,))[1])
    for i in range(len(names)):
        direction = jnp.zeros(len(names)).at[i].set(1.0)
        column = second(direction)
        difference = (gradient(one + step * direction) - gradient(one - step * direction)) / (2 * step)
        assert np.isfinite(column).all()
        assert np.abs(column).max() > 1e-2
        assert np.abs(column - difference).max() < 1e-4 * np.abs(difference).max()


@pytest.mark.parametrize(
    ("stock", "axes"),
    [
        (mx.Stock.box((0, None), (-2e-3, 5e-3)), ()),
        pytest.param(mx.Stock.box((0, None), (-2e-3, 5e-3)), ("x", "y"), marks=pytest.mark.long),
        (ENDLESS, ("x", "y")),
    ],
    ids=["rigid, borders", "2-DOF, borders", "2-DOF"],
)
def test_every_derivative_is_finite(stock, axes):
    template = slot(stock=stock, axes=axes, duration=0.0045, steps_per_tooth=20)
    rest = eqx.filter(template, eqx.is_inexact_array, inverse=True)

    @jax.jit
    def everything(numbers):
        def outputs(numbers):
            sim = mx.simulate(eqx.combine(numbers, rest), throw=False)
            return jnp.concatenate([sim.force.ravel(), sim.displacement.ravel(), sim.chip_thickness.ravel()])

        # One direction through all leaves at once: a single NaN anywhere in the Jacobian would reach the sum.
        traces, change = jax.linearize(outputs, numbers)
        forward = change(jax.tree.map(jnp.ones_like, numbers))
        return traces, forward, jax.linear_transpose(change, numbers)(jnp.ones_like(traces))

    for feed in (4 / 60, 0.0):
        for width in (1e-6, 0.0):
            for start in ((-0.01, 0.0), (-0.03, 0.0)):  # touching; out of contact, or in a slot with the surface at h = 0
                case = slot(stock=stock, axes=axes, duration=0.0045, steps_per_tooth=20, feed=feed, width=width, start=start)
                leaves = jax.tree.leaves(everything(eqx.filter(case, eqx.is_inexact_array)))
                assert all(np.isfinite(leaf).all() for leaf in leaves), (feed, width, start)


@pytest.mark.long
def test_a_law_of_ones_own_with_an_array_of_coefficients():
    class Polynomial(mx.ForceLaw):
        coefficients: jax.Array
        kr: jax.Array

        def tangential(self, h):
            return self.coefficients[0] * h + self.coefficients[1] * h**2

        def work(self, low, high):
            return self.coefficients[0] * (high**2 - low**2) / 2 + self.coefficients[1] * (high**3 - low**3) / 3

    def force(coefficients):
        return mx.simulate(slot(force=Polynomial(coefficients, jnp.asarray(0.3)), duration=0.006), throw=False).force

    given = jnp.array([8e8, -1e12])
    step = jnp.array([8e2, 0.0])
    difference = (force(given + step) - force(given - step)) / (2 * step[0])
    column = jax.jacfwd(force)(given)[..., 0]
    assert np.abs(column - difference).max() < 1e-6 * np.abs(difference).max()


def test_the_derivative_by_the_width_of_the_gates_in_chatter():
    # The choice between passes is blended over the width, too.
    case = slot(mass=1.0, stiffness=3e6, sweeps=20, blocks=4, duration=0.03, stock=ENDLESS)
    case = eqx.tree_at(lambda c: c.cut.depth, case, jnp.asarray(3e-3))

    def force(factor):
        width = case.settings.width * factor
        return mx.simulate(eqx.tree_at(lambda c: c.settings.width, case, width), throw=False).force

    column, step = jax.jacfwd(force)(jnp.asarray(1.0)), 2.5e-7
    difference = (force(1 + step) - force(1 - step)) / (2 * step)
    assert np.abs(column - difference).max() < 1e-3 * np.abs(difference).max()
