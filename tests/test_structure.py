import jax
import numpy as np
import pytest

import millax as mx


def test_one_number_per_axis_and_matrix_are_the_same_structure():
    forms = [
        mx.Structure(("x", "y"), 100.0, 3e5, damping_ratio=0.05),
        mx.Structure(("x", "y"), [100.0, 100.0], [3e5, 3e5], damping_ratio=[0.05, 0.05]),
        mx.Structure(("x", "y"), np.eye(2) * 100, np.eye(2) * 3e5, damping_ratio=np.eye(2) * 0.05),
        mx.Structure(("x", "y"), 100.0, 3e5, damping=2 * 0.05 * np.sqrt(3e5 * 100)),
    ]
    for structure in forms:
        assert np.allclose(structure.damping_matrix, np.eye(2) * 547.7225575)  # the papers' 550 kg/s
        assert np.allclose(structure.mass_matrix, np.eye(2) * 100)
        assert np.allclose(structure.stiffness_matrix, np.eye(2) * 3e5)


def test_damping_ratio_has_a_gradient_where_there_is_no_coupling():
    def total(stiffness):
        return mx.Structure(("x", "y"), np.eye(2) * 100, stiffness, damping_ratio=np.full((2, 2), 0.05)).damping_matrix.sum()

    assert np.isfinite(jax.grad(total)(np.eye(2) * 3e5)).all()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"axes": ("y", "x")}, "structure.axes"),
        ({"axes": ("x", "w")}, "structure.axes"),
        ({"mass": -1.0}, "structure.mass: -1 kg given"),
        ({"mass": [1.0, 2.0, 3.0]}, r"structure.mass: shape \(3,\) given"),
        ({"mass": [[1.0, 2.0], [2.0, 1.0]]}, "not positive definite"),
        ({"stiffness": float("inf")}, "structure.stiffness: inf N/m given"),
        ({"damping": 1.0}, "only one of them"),
        ({"damping_ratio": None}, "only one of them"),
        ({"damping_ratio": -0.1}, "structure.damping_ratio: -0.1 given"),
        ({"mode_shapes": [[1.0, 0.0, 0.0]]}, "structure.mode_shapes"),
    ],
)
def test_bad_structures_are_named(arguments, message):
    good = {"axes": ("x", "y"), "mass": 100.0, "stiffness": 3e5, "damping_ratio": 0.05}
    with pytest.raises(ValueError, match=message):
        mx.Structure(**(good | arguments))
