"""Small sums of products that stay fast in a batch, in both directions of differentiation.

XLA on a processor multiplies one vector and a matrix well. Several vectors and a small matrix, as a vmapped forward
derivative has them, it multiplies ten times slower than it could, and sums over an axis that is not the last it does not
compute in vectors at all. Written out, term by term, both become vector instructions. But the derivative of a written-out
sum in reverse is a heap of padded slices; here it is again a sum of products. An operation that has its own form in a batch
and its own transpose is, in JAX, a primitive.
"""

import math
import string

import jax.numpy as jnp
import numpy as np
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir
from jaxtyping import Array

LONGEST = 32
"""Terms that are written out at most; longer sums are large enough for a library."""


def einsum(formula: str, x: Array, y: Array) -> Array:
    """`jnp.einsum` of two arrays: every index occurs at most once in each, and twice in all."""
    return _einsum.bind(x, y, formula=formula)


def _parts(formula: str) -> list[str]:
    return formula.replace("->", ",").split(",")


def _sizes(formula: str, x, y) -> dict[str, int]:
    """The length of the axis of every index."""
    of_x, of_y, _ = _parts(formula)
    return dict(zip(of_x + of_y, x.shape + y.shape, strict=True))


def _computed(x, y, *, formula: str):
    of_x, of_y, of_sum = _parts(formula)
    size = _sizes(formula, x, y)
    summed = [index for index in size if index not in of_sum]
    one_vector = x.ndim == 1 and y.ndim == 2 and len(summed) == 1
    if one_vector or not 0 < math.prod(size[index] for index in summed) <= LONGEST:
        return jnp.einsum(formula, x, y)

    def term(x, indices, at):
        """One factor of one term, its axes in the order of the sum."""
        x = x[tuple(at.get(index, slice(None)) for index in indices)]
        left = [index for index in indices if index not in at]
        x = x.transpose([left.index(index) for index in of_sum if index in left])
        return x[tuple(slice(None) if index in left else None for index in of_sum)]

    terms = []
    for values in np.ndindex(*(size[index] for index in summed)):
        at = dict(zip(summed, values, strict=True))
        terms.append(term(x, of_x, at) * term(y, of_y, at))
    return sum(terms[1:], terms[0])


def _shape(x, y, *, formula: str):
    size = _sizes(formula, x, y)
    return x.update(shape=tuple(size[index] for index in _parts(formula)[2]), dtype=jnp.result_type(x, y), weak_type=False)


def _batched(operands, axes, *, formula: str):
    batch = next(letter for letter in string.ascii_letters if letter not in formula)
    of_x, of_y, of_sum = _parts(formula)
    moved, named = [], []
    for x, axis, indices in zip(operands, axes, (of_x, of_y), strict=True):
        moved.append(x if axis is None else jnp.moveaxis(x, axis, 0))
        named.append(indices if axis is None else batch + indices)
    return _einsum.bind(*moved, formula=f"{named[0]},{named[1]}->{batch}{of_sum}"), 0


def _by_x(change, x, y, *, formula: str):
    of_x, of_y, of_sum = _parts(formula)
    return _einsum.bind(change, y, formula=f"{of_sum},{of_y}->{of_x}")


def _by_y(change, x, y, *, formula: str):
    of_x, of_y, of_sum = _parts(formula)
    return _einsum.bind(x, change, formula=f"{of_x},{of_sum}->{of_y}")


_einsum = Primitive("einsum")
_einsum.def_impl(_computed)
_einsum.def_abstract_eval(_shape)
mlir.register_lowering(_einsum, mlir.lower_fun(_computed, multiple_results=False))
batching.primitive_batchers[_einsum] = _batched
ad.defbilinear(_einsum, _by_x, _by_y)
