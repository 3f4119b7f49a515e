"""The numbers of a case by their names."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import slot

import millax as mx
from millax._names import quantity_of, read_value, replace, valid_names, value_of

CASE = slot(stiffness=jnp.array([3e5, 4e5]), damping_ratio=jnp.array([0.05, 0.06]))


def test_names_reach_every_number_of_the_case():
    assert "structure.damping_ratio.x" in valid_names(CASE)
    assert "structure.mass" in valid_names(CASE)
    assert value_of(CASE, "structure.stiffness.y") == 4e5
    assert read_value(CASE, "structure.stiffness.y", "0.5 N/um") == pytest.approx(5e5)
    rigid = slot(axes=())
    assert not any(name.startswith("structure") for name in valid_names(rigid))


def test_every_number_can_be_replaced_and_nothing_else_changes():
    for name in valid_names(CASE):
        other = replace(CASE, {name: jnp.asarray(0.123)})
        values = {known: value_of(other, known) for known in valid_names(other)}
        assert values == {known: value_of(CASE, known) for known in values} | {name: 0.123}


def test_replacing_is_differentiable():
    slopes = jax.jacfwd(lambda v: replace(CASE, {"structure.stiffness.y": v, "force.k0": v}).structure.stiffness)(1.0)
    np.testing.assert_array_equal(slopes, [0.0, 1.0])


def test_units_and_ranges():
    assert quantity_of(CASE, "cut.spindle_speed").unit == "rad/s"
    # The table of keys lets a stiffness matrix hold negative entries; the numbers with names are diagonal.
    assert not quantity_of(CASE, "structure.stiffness.x").range.admits(np.array(-1.0))
    exponential = slot(force=mx.ExponentialLaw(kf=1e8, m=0.7, kr=0.3))
    assert quantity_of(exponential, "force.kf").unit == "N/m^1.7"


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("force.kO0", "did you mean force.k0"),
        ("nonsense", "Valid: tool.diameter"),
        ("structure.mass.x", "one number for all axes; name it structure.mass,"),
        ("structure.stiffness", "one by one: structure.stiffness.x, structure.stiffness.y"),
    ],
)
def test_a_name_that_is_none_is_answered_with_those_that_are(name, words):
    with pytest.raises(ValueError, match=r".") as error:
        value_of(CASE, name)
    assert words in str(error.value)


def test_the_entries_of_a_matrix_have_no_names():
    case = slot(stiffness=jnp.array([[3e5, 1e4], [1e4, 3e5]]))
    with pytest.raises(ValueError, match=r"structure\.stiffness as a matrix"):
        value_of(case, "structure.stiffness.x")


class Own(mx.LinearLaw):
    """As a user may write it, from a law of ours."""


class Alien(mx.ForceLaw):
    """From nothing of ours: no case file knows its numbers."""

    kr: jax.Array
    slope: jax.Array

    def tangential(self, h):
        return self.slope * h

    def work(self, low, high):
        return self.slope * (high**2 - low**2) / 2


def test_laws_of_the_user():
    own = slot(force=Own(kt=1e9, kr=0.3))
    assert {"force.kt", "force.kr"} <= set(valid_names(own))
    alien = slot(force=Alien(kr=jnp.asarray(0.3), slope=jnp.asarray(1e9)))
    assert "structure.mass" in valid_names(alien)
    assert not any(name.startswith("force.") for name in valid_names(alien))
    with pytest.raises(ValueError, match=r"force\.slope: unknown parameter; this is no number of the case"):
        value_of(alien, "force.slope")
