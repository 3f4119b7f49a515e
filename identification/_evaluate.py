"""The model beside the measurements, and how it changes with the free parameters, at one point."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from millax import Case, Simulation, simulate

from ._compare import Comparison
from ._deflection import Deflection
from ._parameters import FreeParameters


class Evaluation(eqx.Module):
    """Model and Jacobian at one point, all that least squares needs of them.

    The residuals r = model - measured of channel c and their Jacobian J enter a fit only through the triangular factor
    R_c of [J, r]: J^T J, J^T r and r^T r are those of R_c, whatever weight the channel gets afterwards. `prior` is [J, r] of
    what was known before, in standard deviations of it.
    """

    triangles: Float[Array, "channels n+1 n+1"]
    prior: Float[Array, "k n+1"]
    fitted: tuple[Float[Array, "channels samples"], ...]
    status: Array
    covered: Array

    def whitened(self, sigma: Float[np.ndarray, " channels"]) -> Float[np.ndarray, "n+1 n+1"]:
        """The triangular factor of [J, r] over all channels, in units of their noise, and of what was known."""
        rows = np.asarray(self.triangles) / sigma[:, None, None]
        every = np.concatenate([rows.reshape(-1, rows.shape[-1]), np.asarray(self.prior)])
        return np.asarray(np.linalg.qr(every, mode="r"))


@eqx.filter_jit
def evaluate(
    cases: tuple[Case, ...],
    case_of: tuple[int, ...],
    numbers: FreeParameters,
    comparisons: tuple[Comparison | Deflection, ...],
    y: Array,
) -> Evaluation:
    """The `Evaluation` of `cases` with their free numbers at `y`; `case_of` says which belongs to each comparison.

    Only cases of traces are simulated: load tests need their robots alone.
    """

    def model(y):
        changed = [numbers.insert(case, y, place) for place, case in enumerate(cases)]
        cuts = sorted({i for one, i in zip(comparisons, case_of, strict=True) if isinstance(one, Comparison)})
        sims = dict(zip(cuts, together([changed[i] for i in cuts]), strict=True))
        fitted, covered = [], [jnp.array(True)]
        for comparison, i in zip(comparisons, case_of, strict=True):
            if isinstance(comparison, Deflection):
                fitted.append(comparison.predict(changed[i]))
            else:
                fitted.append(comparison.predict(sims[i], changed[i]))
                covered.append(comparison.covered(sims[i], changed[i]))
        status = jnp.stack([jnp.array(0), *(sim.status for sim in sims.values())])
        return tuple(fitted), (jnp.max(status), jnp.stack(covered).all())

    def push(direction):
        fitted, change, aux = jax.jvp(model, (y,), (direction,), has_aux=True)
        return fitted, change, aux

    # jacfwd, but for the order of axes: parameters first is how the factorisation wants its columns.
    fitted, changes, (status, covered) = jax.vmap(push, out_axes=(None, 0, None))(jnp.eye(len(y)))
    triangles = [
        triangle(jnp.concatenate([change, (model - comparison.measured)[None]]))
        for comparison, model, change in zip(comparisons, fitted, changes, strict=True)
    ]
    prior = jnp.concatenate([jax.jacfwd(numbers.prior)(y), numbers.prior(y)[:, None]], axis=1)
    return Evaluation(jnp.concatenate(triangles), prior, fitted, status, covered)


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
