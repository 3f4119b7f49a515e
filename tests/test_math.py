import jax
import jax.numpy as jnp
import numpy as np
import pytest

from millax._math import half_change, log1p, minimum, positive_part, preferred


def test_positive_part_is_the_mean_of_the_hard_one():
    x = np.linspace(-3, 3, 61)
    inside = np.linspace(-1, 1, 200001)
    mean = np.array([np.trapezoid(np.maximum(xi + 0.7 * inside, 0), inside) / 2 for xi in x])
    assert np.allclose(positive_part(jnp.asarray(x), 0.7), mean, atol=1e-9)


def test_gates_are_hard_outside_their_width():
    assert positive_part(-1.0, 1.0) == 0
    assert positive_part(1.0, 1.0) == 1
    assert minimum(2.0, 5.0, 1.0) == 2
    assert minimum(5.0, 2.0, 1.0) == 2
    assert minimum(2.0, 2.0, 1.0) == 1.75  # the stated bias, width/4


@pytest.mark.parametrize("width", [0.0, 1.0])
@pytest.mark.parametrize("x", [-1.0, 0.0, 1.0])
def test_gradients_at_the_kinks(x, width):
    value, slope = jax.value_and_grad(positive_part)(x, width)
    assert jnp.isfinite(value)
    if width:
        assert slope == (x + 1) / 2
    else:
        assert slope == {-1.0: 0.0, 0.0: 0.5, 1.0: 1.0}[x]
    assert jnp.isfinite(jax.grad(positive_part, argnums=1)(x, width))


def test_the_preferred_of_two_is_the_smaller():
    assert [float(x) for x in preferred(1.0, 2.0, 1.0)] == [0, 0]
    assert [float(x) for x in preferred(2.0, 1.0, 1.0)] == [1, 0]
    assert preferred(1.5, 1.5, 1.0)[0] == 0.5
    assert [float(preferred(a, b, 0.0)[0]) for a, b in ((1.0, 2.0), (2.0, 1.0))] == [0.0, 1.0]
    weight, slope = preferred(1.4, 1.5, 1.0)
    assert float(slope) == pytest.approx(float(jax.grad(lambda a: preferred(a, 1.5, 1.0)[0])(1.4)), rel=1e-12)
    assert 0 < weight < 0.5
    assert jnp.isfinite(preferred(1.0, 1.0, 0.0)[1])


def test_half_change_has_a_gradient_where_nothing_changes():
    assert half_change(3.0, 0.5, 0.0) == pytest.approx(0.75)
    assert half_change(0.0, 0.5, 2.0) == pytest.approx(2.0)
    assert jnp.isfinite(jax.grad(half_change)(0.0, 0.5, 0.0))


@pytest.mark.parametrize(("kind", "tolerance"), [(np.float64, 1e-15), (np.float32, 3e-7)])
def test_the_logarithm_of_one_plus(kind, tolerance):
    x = np.concatenate([np.logspace(-18, 8, 200_001), np.linspace(0.0, 3.0, 200_001)[1:]]).astype(kind)
    found, exact = np.asarray(log1p(jnp.asarray(x))), np.log1p(x.astype(np.longdouble))
    assert found.dtype == kind
    assert np.abs(found / exact - 1).max() <= tolerance
    assert np.all(np.diff(found[:200_001]) >= 0)


def test_the_logarithm_of_one_plus_nothing():
    nothing = jnp.asarray(0.0)
    assert jax.value_and_grad(log1p)(nothing) == (0.0, 1.0)
    assert jax.grad(jax.grad(log1p))(nothing) == -1.0
    assert jax.grad(log1p)(jnp.asarray(3.0)) == 0.25
    edges = jnp.array([-0.99, -1e-3, 0.0, 5e-324, 2.2e-308, 1e-17, 1e8, 1e300])
    assert np.isfinite(log1p(edges)).all()
    assert np.isfinite(jax.vmap(jax.grad(log1p))(edges)).all()
    assert not np.isfinite(log1p(jnp.array([np.nan, np.inf]))).any()
