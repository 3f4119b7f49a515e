"""What holds the tool: a linear mass-spring-damper, and its exact response over a block of time steps."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ._check import concrete, finite, not_negative, positive
from ._types import AXES, Matrix, as_number, optional


class Structure(eqx.Module):
    """M q'' + C q' + K q = S^T F, tool displacement u = S q (E 23, 32, 33; C 1).

    Each of `mass`, `stiffness` and the damping may be one number for all coordinates, one per coordinate (a diagonal
    matrix), or a full matrix. They keep the form in which they are given, so that a fit varies exactly these numbers.

    **Arguments:**

    - `axes`: directions in which the tool moves, a tuple of "x", "y", "z". Static. Empty: a rigid tool.
    - `mass`: M [kg], positive definite.
    - `stiffness`: K [N/m].
    - `damping`: C [N s/m]; or
    - `damping_ratio`: zeta [-], >= 0, with C_ij = 2 zeta_ij sqrt(K_ij M_ij) (E 32): one number or one per coordinate set
      the diagonal of C, a matrix all of it. Exactly one of the two is given.
    - `mode_shapes`: S, shape (axes, coordinates): the tool's motion as a linear map of the coordinates. None (default) is
      the identity: one coordinate per axis.

    Raises `ValueError` for shapes that do not fit, a mass that is not positive, negative damping, or damping given twice
    or not at all.
    """

    axes: tuple[str, ...] = eqx.field(static=True)
    mass: Float[Array, "..."] = eqx.field(converter=as_number)
    stiffness: Float[Array, "..."] = eqx.field(converter=as_number)
    damping: Float[Array, "..."] | None = eqx.field(converter=optional, default=None)
    damping_ratio: Float[Array, "..."] | None = eqx.field(converter=optional, default=None)
    mode_shapes: Float[Array, "axes coordinates"] | None = eqx.field(converter=optional, default=None)

    def __check_init__(self):
        order = [AXES.index(a) if a in AXES else -1 for a in self.axes]
        if -1 in order or order != sorted(set(order)):
            raise ValueError(f"structure.axes: {list(self.axes)} given; use each of x, y, z at most once, in this order")
        if (self.damping is None) == (self.damping_ratio is None):
            raise ValueError("structure: give damping or damping_ratio, and only one of them")
        if self.mode_shapes is not None and self.mode_shapes.shape[:-1] != (len(self.axes),):
            raise ValueError(
                f"structure.mode_shapes: shape {self.mode_shapes.shape} given; one row per axis ({len(self.axes)}) and "
                "one column per coordinate is needed"
            )
        n = self.coordinates
        for name, value in (
            ("mass", self.mass),
            ("stiffness", self.stiffness),
            ("damping", self.damping),
            ("damping_ratio", self.damping_ratio),
        ):
            if value is not None and value.shape not in ((), (n,), (n, n)):
                raise ValueError(
                    f"structure.{name}: shape {value.shape} given; with {n} coordinates it is one number, "
                    f"{n} numbers, or a matrix of {n} by {n}"
                )
        finite("structure.stiffness", self.stiffness, "N/m")
        if self.mass.ndim < 2:
            positive("structure.mass", self.mass, "kg")
        else:
            finite("structure.mass", self.mass, "kg")
            mass = concrete(self.mass)
            if mass is not None and np.linalg.eigvalsh((mass + mass.T) / 2).min() <= 0:
                raise ValueError("structure.mass: the matrix is not positive definite; every eigenvalue must exceed 0 kg")
        for name, value, unit in (("damping", self.damping, "N s/m"), ("damping_ratio", self.damping_ratio, "")):
            if value is not None:
                (not_negative if value.ndim < 2 else finite)(f"structure.{name}", value, unit)

    @staticmethod
    def rigid() -> "Structure":
        """A tool that does not move from its commanded path (the papers' case A)."""
        return Structure((), jnp.zeros(0), jnp.zeros(0), damping=jnp.zeros(0))

    @property
    def coordinates(self) -> int:
        """Number of generalised coordinates q."""
        return len(self.axes) if self.mode_shapes is None else self.mode_shapes.shape[-1]

    @property
    def mass_matrix(self) -> Matrix:
        """M [kg]."""
        return _matrix(self.mass, self.coordinates)

    @property
    def stiffness_matrix(self) -> Matrix:
        """K [N/m]."""
        return _matrix(self.stiffness, self.coordinates)

    @property
    def damping_matrix(self) -> Matrix:
        """C [N s/m]."""
        if self.damping is not None:
            return _matrix(self.damping, self.coordinates)
        assert self.damping_ratio is not None  # exactly one of the two is given
        product = self.stiffness_matrix * self.mass_matrix
        ratio = _matrix(self.damping_ratio, self.coordinates)
        # sqrt has no derivative at 0: entries without stiffness or mass carry no damping, and no gradient.
        coupled = product > 0
        return 2 * ratio * jnp.where(coupled, jnp.sqrt(jnp.where(coupled, product, 1.0)), 0.0)

    @property
    def shapes(self) -> Float[Array, "axes coordinates"]:
        """S [-]: tool displacement per coordinate."""
        return jnp.eye(self.coordinates) if self.mode_shapes is None else self.mode_shapes

    @property
    def in_plane_shapes(self) -> Float[Array, "2 coordinates"]:
        """The rows of S for x and y, zero where the tool does not move in that direction."""
        return self.shapes_along(AXES[:2])

    def shapes_along(self, axes: tuple[str, ...]) -> Float[Array, "axes coordinates"]:
        """The rows of S for these directions, zero where the tool does not move in one."""
        rows = [self.shapes[self.axes.index(a)] if a in self.axes else jnp.zeros(self.coordinates) for a in axes]
        return jnp.stack(rows)


def free_rates(mass, damping, stiffness) -> Float[np.ndarray, "*batch states states"]:
    """The matrix A of (q, q')' = A (q, q') for M q'' + C q' + K q = 0, in NumPy. Leading axes are a batch."""
    mass, damping, stiffness = map(np.asarray, (mass, damping, stiffness))
    n = mass.shape[-1]
    acceleration = -np.linalg.solve(mass, np.concatenate([stiffness, damping], axis=-1))
    velocity = np.broadcast_to(np.eye(n, 2 * n, n), acceleration.shape)
    return np.concatenate([velocity, acceleration], axis=-2)


def _matrix(value: Array, n: int) -> Matrix:
    return value if value.ndim == 2 else jnp.diag(jnp.broadcast_to(value, (n,)))
