"""Other ways to compute the slot of `benchmarks.slot`: a scalar C loop, and a step-by-step `lax.scan`."""

import ctypes
import shutil
import subprocess
import tempfile
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from scipy.linalg import expm

import millax as mx


def _discrete(case: mx.Case, duration: float):
    s = case.structure
    mass, damping, stiffness = (np.asarray(m) for m in (s.mass_matrix, s.damping_matrix, s.stiffness_matrix))
    rates = np.zeros((6, 6))
    rates[:2, 2:4] = np.eye(2)
    rates[2:4] = np.linalg.solve(mass, np.hstack([-stiffness, -damping, np.eye(2)]))
    exponential = expm(rates * duration)
    return np.ascontiguousarray(exponential[:4, :4]), np.ascontiguousarray(exponential[:4, 4:])


def _step(case: mx.Case) -> float:
    return float(case.cut.tooth_period(case.tool)) / case.settings.steps_per_tooth


def c_loop(case: mx.Case):
    """The compiled C loop as a function without arguments that returns (force, displacement); None without gcc."""
    compiler = shutil.which("gcc")
    if compiler is None:
        return None
    folder = tempfile.TemporaryDirectory()
    library = Path(folder.name) / "slot.so"
    source = Path(__file__).with_name("slot.c")
    flags = ["-O3", "-march=native", "-ffast-math", "-shared", "-fPIC"]
    subprocess.run([compiler, *flags, str(source), "-o", str(library), "-lm"], check=True)
    function = ctypes.CDLL(str(library)).slot
    dt, steps, law = _step(case), case.settings.steps, case.force
    assert isinstance(law, mx.FractionalLaw)
    matrices = [*_discrete(case, dt / 2), *_discrete(case, dt)]
    force, move = np.empty((steps, 2)), np.empty((steps, 2))
    numbers = (
        dt,
        case.cut.spindle_speed,
        case.cut.feed_rate,
        case.tool.radius,
        law.k0 * case.cut.depth,
        law.hs,
        law.r,
        law.kr,
    )
    arguments = [
        *(ctypes.c_int(n) for n in (case.settings.steps_per_tooth, case.tool.teeth, case.settings.passes)),
        ctypes.c_long(steps),
        *(ctypes.c_double(float(x)) for x in numbers),
        *(array.ctypes.data_as(ctypes.POINTER(ctypes.c_double)) for array in (*matrices, force, move)),
    ]

    def run(keep=(folder, matrices)):
        function(*arguments)
        return force, move

    return run


def step_by_step(case: mx.Case):
    """The obvious program in JAX: a scan over time steps, earlier passes in a ring buffer. Jitted."""
    dt, law, radius = _step(case), case.force, float(case.tool.radius)
    assert isinstance(law, mx.FractionalLaw)
    speed, feed = float(case.cut.spindle_speed), float(case.cut.feed_rate)
    n, teeth, passes = case.settings.steps_per_tooth, case.tool.teeth, case.settings.passes
    half, half_in = map(jnp.asarray, _discrete(case, dt / 2))
    whole, whole_in = map(jnp.asarray, _discrete(case, dt))
    k = jnp.arange(1, passes + 1)
    place = jnp.arange(teeth) * (2 * jnp.pi / teeth)

    def step(carry, index):
        z, force, past = carry
        middle = half @ z + half_in @ force
        phi = (index + 0.5) * dt * speed + place
        cos, sin = jnp.cos(phi)[:, None], jnp.sin(phi)[:, None]
        q = past[(index - k * n) % (passes * n)]
        dx, dy = k * feed * dt * n + middle[0] - q[:, 0], middle[1] - q[:, 1]
        along, across = cos * dx - sin * dy, -sin * dx - cos * dy
        slope = cos * (feed + q[:, 2]) - sin * q[:, 3]
        gap = jnp.min(along + across * (across / (2 * radius) - slope / (speed * radius)), axis=1)
        cos, sin = cos[:, 0], sin[:, 0]
        tip = -radius + feed * (index + 0.5) * dt + middle[0] + radius * cos
        h = jnp.maximum(jnp.where(cos > 0, jnp.minimum(gap, tip / jnp.where(cos > 0, cos, 1.0)), gap), 0.0)
        tangential = case.cut.depth * law.tangential(h)
        force = jnp.stack([jnp.sum(tangential * (sin - law.kr * cos)), jnp.sum(tangential * (cos + law.kr * sin))])
        past = past.at[index % (passes * n)].set(middle)
        return (whole @ z + whole_in @ force, force, past), (force, middle[:2])

    @jax.jit
    def run():
        start = (jnp.zeros(4), jnp.zeros(2), jnp.zeros((passes * n, 4)))
        return lax.scan(step, start, jnp.arange(case.settings.steps))[1]

    return run
