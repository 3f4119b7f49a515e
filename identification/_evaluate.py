"""The model beside the measurements, and how it changes with the free parameters, at one point."""

import itertools
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from millax import Case, Simulation, simulate

from ._compare import Comparison
from ._deflection import Deflection
from ._noise import Noise
from ._parameters import FreeParameters


class Prediction(eqx.Module):
    """What the model says: of each trace and load test its channels [SI], and whether they may be used: the worst status of
    the simulations, and whether these are long enough for the traces."""

    fitted: tuple[Float[Array, "channels samples"], ...]
    status: Array
    covered: Array

    @property
    def usable(self) -> Array:
        """Whether everything is."""
        finite = jnp.stack([jnp.isfinite(one).all() for one in self.fitted]).all()
        return (self.status == 0) & self.covered & finite


class Model(eqx.Module):
    """All that a point is evaluated with, as one pytree whose numbers may change without a new compilation.

    `case_of` says which of the `cases` belongs to each of the `comparisons`, the measurements ready to be compared; only
    cases of traces are simulated: load tests need their robots alone.
    """

    cases: tuple[Case, ...]
    case_of: tuple[int, ...] = eqx.field(static=True)
    numbers: FreeParameters
    comparisons: tuple[Comparison | Deflection, ...]

    def predict(self, y: Float[Array, " n"]) -> Prediction:
        """The model with its free numbers at `y`. Differentiable."""
        changed = [self.numbers.insert(case, y, place) for place, case in enumerate(self.cases)]
        pairs = list(zip(self.comparisons, self.case_of, strict=True))
        cuts = sorted({i for one, i in pairs if isinstance(one, Comparison)})
        sims = dict(zip(cuts, together([changed[i] for i in cuts]), strict=True))
        fitted, covered = [], [jnp.array(True)]
        for comparison, i in pairs:
            if isinstance(comparison, Deflection):
                fitted.append(comparison.predict(changed[i]))
            else:
                fitted.append(comparison.predict(sims[i], changed[i]))
                covered.append(comparison.covered(sims[i], changed[i]))
        status = jnp.stack([jnp.array(0), *(sim.status for sim in sims.values())])
        return Prediction(tuple(fitted), jnp.max(status), jnp.stack(covered).all())

    def residuals(self, fitted: Sequence[Array]) -> tuple[Float[Array, "channels samples"], ...]:
        """Model less measured."""
        return tuple(model - one.measured for model, one in zip(fitted, self.comparisons, strict=True))

    def noises(self, noise: Noise) -> tuple[Noise, ...]:
        """The noise of each trace and load test, of that of all channels. Measurements of a load test do not follow each
        other in time."""
        ends = np.cumsum([0, *(len(one.channels) for one in self.comparisons)])
        parts = [noise.part(begin, end) for begin, end in itertools.pairwise(ends)]
        return tuple(
            part if isinstance(one, Comparison) else Noise(part.sigma, jnp.zeros((len(part.sigma), 0)), part.degrees)
            for part, one in zip(parts, self.comparisons, strict=True)
        )

    def errors(self, noise: Noise, y: Float[Array, " n"]) -> tuple[Float[Array, " rows"], Array]:
        """Independent residuals over the size of their noise, of everything measured and of what was known before, and
        whether they may be used: half the sum of their squares is -log of the probability. Differentiable."""
        found = self.predict(y)
        parts = zip(self.noises(noise), self.residuals(found.fitted), strict=True)
        rows = [(part.independent(residuals) / part.sigma[:, None]).ravel() for part, residuals in parts]
        return jnp.concatenate([*rows, self.numbers.prior(y)]), found.usable


class Evaluation(eqx.Module):
    """Model and Jacobian at one point, all that least squares needs of them.

    The independent residuals e of channel c, see `_noise`, and their Jacobian J enter a fit only through the triangular
    factor R_c of [J, e]: J^T J, J^T e and e^T e are those of R_c, whatever weight the channel gets afterwards. `prior` is
    [J, r] of what was known before, in standard deviations of it. `changes` are the derivatives of what is `fitted`.
    """

    triangles: Float[Array, "channels n+1 n+1"]
    prior: Float[Array, "k n+1"]
    fitted: tuple[Float[Array, "channels samples"], ...]
    changes: tuple[Float[Array, "n channels samples"], ...]
    status: Array
    covered: Array

    def cost(self, sigma: Float[np.ndarray, " channels"]) -> float:
        """Sum of the squares of the independent residuals over the size of their noise, and of what was known."""
        rows = np.asarray(self.triangles)[:, :, -1] / sigma[:, None]
        return float(np.sum(rows**2) + np.sum(np.asarray(self.prior)[:, -1] ** 2))

    def whitened(self, sigma: Float[np.ndarray, " channels"], information: float = 1.0) -> Float[np.ndarray, "n+1 n+1"]:
        """The triangular factor of [J, e] over all channels, in units of their noise, and of what was known; for the
        uncertainty with the `information` of the noise."""
        rows = np.asarray(self.triangles) / (sigma[:, None, None] / np.sqrt(information))
        every = np.concatenate([rows.reshape(-1, rows.shape[-1]), np.asarray(self.prior)])
        return np.asarray(np.linalg.qr(every, mode="r"))


@eqx.filter_jit
def evaluate(model: Model, noise: Noise, y: Array) -> Evaluation:
    """The `Evaluation` of `model` with its free numbers at `y`."""
    return evaluation(model, noise, y)


def evaluation(model: Model, noise: Noise, y: Array) -> Evaluation:
    """The same, to be part of a larger program."""

    def forward(y):
        found = model.predict(y)
        return found.fitted, (found.status, found.covered)

    def push(direction):
        return jax.jvp(forward, (y,), (direction,), has_aux=True)

    # jacfwd, but for the order of axes: parameters first is how the factorisation wants its columns.
    fitted, changes, (status, covered) = jax.vmap(push, out_axes=(None, 0, None))(jnp.eye(len(y)))
    triangles = []
    for part, residuals, change in zip(model.noises(noise), model.residuals(fitted), changes, strict=True):
        independent, along = jax.linearize(part.independent, residuals)
        triangles.append(triangle(jnp.concatenate([jax.vmap(along)(change), independent[None]])))
    numbers = model.numbers
    prior = jnp.concatenate([jax.jacfwd(numbers.prior)(y), numbers.prior(y)[:, None]], axis=1)
    return Evaluation(jnp.concatenate(triangles), prior, fitted, changes, status, covered)


def together(cases: Sequence[Case]) -> list[Simulation]:
    """The simulations of all cases; those of one shape, which differ in numbers only, as one batch."""
    alike: dict[object, list[int]] = {}
    for i, case in enumerate(cases):
        leaves, kind = jax.tree.flatten(case)
        alike.setdefault((kind, tuple(jnp.shape(leaf) for leaf in leaves)), []).append(i)
    found: dict[int, Simulation] = {}
    for which in alike.values():
        if len(which) == 1:
            found[which[0]] = simulate(cases[which[0]], throw=False)
            continue
        batch = jax.tree.map(lambda *leaves: jnp.stack(leaves), *(cases[i] for i in which))
        sims = jax.vmap(lambda case: simulate(case, throw=False))(batch)
        for place, i in enumerate(which):
            found[i] = jax.tree.map(lambda leaf, place=place: leaf[place], sims)
    return [found[i] for i in range(len(cases))]


def triangle(columns: Float[Array, "k channels samples"], part: int = 512) -> Float[Array, "channels k k"]:
    """The triangular factor of every channel's matrix of k columns.

    Factorised in parts, then the factors of the parts: exact, and each part is small enough for LAPACK to leave it to one
    thread. On a busy machine the threads it starts for the whole wait for each other a hundred times as long.
    """
    k, channels, samples = columns.shape
    parts = -(-samples // part)
    padded = jnp.pad(columns, ((0, 0), (0, 0), (0, parts * part - samples)))
    matrices = jnp.moveaxis(padded.reshape(k, channels, parts, part), 0, -1)
    factors = jnp.linalg.qr(matrices, mode="r")
    return jnp.linalg.qr(factors.reshape(channels, parts * k, k), mode="r")
