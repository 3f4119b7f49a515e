"""The exact response of a structure against SciPy's integrator."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import millax as mx
from millax._response import block_response, response_to_one_step

COUPLED = mx.Structure(
    ("x", "y"),
    mass=[[2.0, 0.3, 0.0], [0.3, 1.5, -0.2], [0.0, -0.2, 1.0]],
    stiffness=[[4e6, -5e5, 0.0], [-5e5, 3e6, 2e5], [0.0, 2e5, 6e6]],
    damping=[[80.0, 5.0, 0.0], [5.0, 60.0, 0.0], [0.0, 0.0, 90.0]],
    mode_shapes=[[1.0, 0.2, -0.4], [0.1, 0.9, 0.5]],
)
LIGHT = mx.Structure(("x", "y"), 0.04, 1.34e6, damping_ratio=0.011)
OVERDAMPED = mx.Structure(("x", "y"), 2.0, 4e5, damping_ratio=[3.0, 0.0])
ONE = mx.Structure(("y",), 100.0, 3e5, damping=550.0)


@pytest.mark.parametrize("structure", [COUPLED, LIGHT, OVERDAMPED, ONE], ids=["coupled", "light", "overdamped", "one"])
def test_response_to_stepwise_forces(structure):
    steps, dt = 12, 4e-5
    rng = np.random.default_rng(1)
    force = rng.normal(size=(2, steps))
    n = structure.coordinates
    state = np.concatenate([rng.normal(size=n) * 1e-7, rng.normal(size=n) * 1e-4])
    mass, damping, stiffness = map(np.asarray, (structure.mass_matrix, structure.damping_matrix, structure.stiffness_matrix))
    shapes = np.asarray(structure.in_plane_shapes)

    def rate(t, z, f):
        acceleration = np.linalg.solve(mass, shapes.T @ f - damping @ z[n:] - stiffness @ z[:n])
        return np.concatenate([z[n:], acceleration])

    middles, z = [], state
    for j in range(steps):
        run = solve_ivp(rate, (0, dt), z, t_eval=[dt / 2, dt], args=(force[:, j],), method="DOP853", rtol=1e-12, atol=1e-18)
        middles.append(run.y[:, 0])
        z = run.y[:, 1]
    middles = np.array(middles).T

    response = block_response(structure, jnp.asarray(dt), steps, felt=4)
    start = jnp.concatenate([state[:n], state[n:] * dt])
    pair = (jnp.asarray(force[0]), jnp.asarray(force[1]))
    scale = np.abs(middles[:n]).max()
    position, velocity, end = response.parted(response.motion(start, pair))
    assert np.allclose(position, shapes @ middles[:n], atol=1e-10 * scale, rtol=0)
    speed = np.abs(middles[n:]).max()
    assert np.allclose(velocity, shapes @ middles[n:], atol=1e-10 * speed, rtol=0)
    assert np.allclose(end, np.concatenate([z[:n], z[n:] * dt]), atol=1e-10 * scale, rtol=0)
    rows = [("x", "y").index(a) for a in structure.axes]
    assert np.allclose(response.axes(start, pair).reshape(-1, steps), np.asarray(position)[rows], rtol=1e-12)
    felt = (response.felt.of_state(start) + response.felt.of_force(pair)).reshape(4, steps)
    assert np.allclose(felt[:2], position, atol=1e-14 * scale, rtol=0)
    assert np.allclose(felt[2:], velocity, atol=1e-14 * speed, rtol=0)
    assert np.allclose(response.felt_in(response.motion(start, pair)), felt, atol=1e-14 * speed, rtol=0)


@pytest.mark.parametrize("structure", [COUPLED, ONE], ids=["coupled", "one"])
def test_response_to_one_step_is_the_first_row_of_the_whole(structure):
    dt, steps = jnp.asarray(4e-5), 8
    whole = block_response(structure, dt, steps, felt=4)
    alone = response_to_one_step(structure, dt, steps)
    assert np.allclose(whole.to_one_step(), alone, rtol=1e-12, atol=1e-14 * np.abs(alone).max())


def test_axial_motion_follows_from_coupling():
    structure = mx.Structure(("x", "y", "z"), 10.0, [[1e6, 0, 2e5], [0, 1e6, 0], [2e5, 0, 1e6]], damping=[50.0, 50.0, 50.0])
    response = block_response(structure, jnp.asarray(1e-3), 400)
    push = (jnp.ones(400), jnp.zeros(400))
    static = np.linalg.solve(structure.stiffness_matrix, [1.0, 0.0, 0.0])
    state = jnp.zeros(6)
    for _ in range(10):
        *_, state = response.parted(response.motion(state, push))
    assert np.allclose(response.axes(state, push).reshape(3, -1)[:, -1], static, rtol=1e-3, atol=1e-12)
    assert abs(static[2]) > 0.1 * abs(static[0])
