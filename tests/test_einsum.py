"""Sums of products that are written out in a batch: as `jnp.einsum`, and differentiable as it is."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from millax._einsum import LONGEST, einsum

SIZES = {"k": 3, "c": 5, "f": 2, "m": 4}
FORMULAS = ["k,kc->c", "fkm,km->fm", "fkm,k->fm"]


def operands(formula, sizes, batch=()):
    rng = np.random.default_rng(1)
    x, y = formula.split("->")[0].split(",")
    return [jnp.asarray(rng.normal(size=(*batch, *(sizes[index] for index in indices)))) for indices in (x, y)]


def both(formula):
    return (lambda x, y: einsum(formula, x, y)), (lambda x, y: jnp.einsum(formula, x, y))


def agree(a, b):
    for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True):
        np.testing.assert_allclose(x, y, rtol=1e-13, atol=1e-13)


@pytest.mark.parametrize("formula", FORMULAS)
@pytest.mark.parametrize("k", [3, LONGEST + 1], ids=["short", "long"])
def test_as_numpy_alone_and_in_batches(formula, k):
    ours, numpys = both(formula)
    sizes = SIZES | {"k": k}
    x, y = operands(formula, sizes)
    many_x, many_y = operands(formula, sizes, batch=(2, 6))
    agree(ours(x, y), numpys(x, y))
    agree(jax.vmap(jax.vmap(ours))(many_x, many_y), jax.vmap(jax.vmap(numpys))(many_x, many_y))
    agree(jax.vmap(ours, (0, None))(many_x[0], y), jax.vmap(numpys, (0, None))(many_x[0], y))


@pytest.mark.parametrize("formula", FORMULAS)
def test_derivatives_in_both_directions(formula):
    ours, numpys = both(formula)
    x, y = operands(formula, SIZES)
    for jacobian in (jax.jacfwd, jax.jacrev, lambda f, at: jax.jacfwd(jax.jacrev(f, at), at)):
        agree(jacobian(ours, (0, 1))(x, y), jacobian(numpys, (0, 1))(x, y))


def test_gradient_of_a_batch():
    ours, numpys = both("k,kc->c")
    x, y = operands("k,kc->c", SIZES, batch=(6,))

    def cost(f):
        return lambda x, y: jnp.sum(jnp.sin(jax.vmap(f)(x, y)))

    agree(jax.grad(cost(ours), (0, 1))(x, y), jax.grad(cost(numpys), (0, 1))(x, y))
