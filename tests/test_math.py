import jax
import jax.numpy as jnp
import numpy as np
import pytest

from millax._math import half_change, minimum, positive_part, preferred


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
    assert preferred(1.0, 2.0, 1.0) == 0
    assert preferred(2.0, 1.0, 1.0) == 1
    assert preferred(1.5, 1.5, 1.0) == 0.5
    assert [float(preferred(a, b, 0.0)) for a, b in ((1.0, 2.0), (2.0, 1.0))] == [0.0, 1.0]
    assert jnp.isfinite(jax.grad(preferred)(1.0, 1.0, 0.0))


def test_half_change_has_a_gradient_where_nothing_changes():
    assert half_change(3.0, 0.5, 0.0) == pytest.approx(0.75)
    assert half_change(0.0, 0.5, 2.0) == pytest.approx(2.0)
    assert jnp.isfinite(jax.grad(half_change)(0.0, 0.5, 0.0))
