"""Results on disk, complete: one HDF5 file holds every number and every word, and gives back the same objects.

The file has an attribute `content` that says what it is, `format`, and `millax`, the version that wrote it; a text
`structure`, which is JSON; and a group `arrays` of datasets that are called after their place, such as
`traces.0.fitted`, for other programs to read. In the structure a list, a tuple, a dict, a float that is not finite, an
array and an object are each a JSON object of one kind, {"tuple": [...]}; anything else is itself.

Nothing in a file is run. Objects are those of dataclasses of millax and identification, made without their constructors:
these check and convert what a person gives, which would change numbers (the times of a trace are made even) or refuse what
was accepted before. In their place the fields are compared with those of the class, by name and by type.
"""

import contextlib
import dataclasses
import importlib
import importlib.metadata
import io
import json
import math
import os
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import h5py
import jax
import jax.numpy as jnp
import numpy as np

from millax._sweepfile import write_whole

from ._kinds import fits, hints_of

FORMAT = 1
"""The version of the format."""

COMPRESSED = 4096
"""Bytes from which an array is compressed."""

NUMBERS = "biufc"
"""Kinds of arrays that are kept: truth values and numbers."""

OURS = re.compile(r"((?:millax|identification)(?:\.\w+)*)\.(\w+)")
"""Qualified names of the classes that a file may name."""

ArrayNode = Callable[[Any, str], Any]
"""What stands in the structure for an array at a place."""


def save(path: str | os.PathLike, content: str, value: Any) -> None:
    """Keep `value`, which is `content` in words, in the file `path`: whole, or not at all.

    Raises `ValueError` for what cannot be kept: objects of other packages, such as a force law of one's own.
    """
    buffer = io.BytesIO()
    with h5py.File(buffer, "w") as file:
        arrays = file.create_group("arrays", track_order=True)
        kept: dict[int, Any] = {}

        def keep(array, place: str):
            """The dataset of an array; one for all places at which it is the same object."""
            if id(array) not in kept:
                kept[id(array)] = _write(arrays, place, array)
            return kept[id(array)]

        try:
            structure = tree(value, keep)
        except ValueError as error:
            raise ValueError(f"{path}: nothing was written: {error}") from None
        file["structure"] = json.dumps(structure, ensure_ascii=False, allow_nan=False)
        file.attrs.update({"content": content, "format": FORMAT, "millax": version()})
    write_whole(Path(path), buffer.getvalue())


def load(path: str | os.PathLike, content: str, kind: type) -> Any:
    """What `save` kept, of the class `kind`.

    Raises `ValueError` for a file that is damaged, holds something else, or was written by another version of millax with
    other fields; `OSError` where it cannot be read.
    """
    data = Path(path).read_bytes()
    try:
        file = h5py.File(io.BytesIO(data), "r")
        found, form, by = (file.attrs.get(name) for name in ("content", "format", "millax"))
    except Exception:  # whatever a file that is no HDF5 file, or ends too early, makes the reader raise
        raise ValueError(f"{path}: this is no HDF5 file, or it is damaged; a {content} was expected") from None
    with file:
        if not isinstance(found, str) or found != content:
            raise ValueError(f"{path}: the file does not hold a {content}, but {found or 'something else'}")
        by = f"The file was written by millax {by}, and this is millax {version()}"
        if form is None or not np.array_equal(form, FORMAT):
            raise ValueError(
                f"{path}: format {form} found; this version reads format {FORMAT}. {by}: read it with the one that wrote it"
            )
        try:
            # The link is looked at before it is followed: it could lead to another file.
            value = restored(json.loads(str(_dataset(file, "structure").asstr()[()])), _Arrays(file))
            if not isinstance(value, kind):
                raise ValueError(f"{type(value).__name__} found where {kind.__name__} belongs")
        except (ValueError, TypeError, KeyError, OSError, RuntimeError, RecursionError) as error:
            raise ValueError(
                f"{path}: the {content} cannot be read: {error}. {by}: read it with the one that wrote it, or make it again"
            ) from error
    return value


def version() -> str:
    """Of millax."""
    return importlib.metadata.version("millax")


# ---- from values to the structure


def tree(value: Any, array: ArrayNode, place: str = "") -> Any:
    """`value` as JSON can hold it; `array` says what stands for an array.

    Texts, numbers and dicts of other libraries, as readers of files make them, count as those of Python. Raises
    `ValueError` for what is neither data nor a dataclass of millax or identification.
    """

    def inner(part, step):
        return tree(part, array, f"{place}.{step}".lstrip("."))

    if value is None or isinstance(value, bool):
        return value
    if isinstance(value, np.ndarray | np.generic | jax.Array):
        return array(value, place)
    if isinstance(value, str):
        return str.__str__(value)
    if isinstance(value, int):
        return int(value)
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else {"float": repr(float(value))}
    if isinstance(value, list | tuple) and not hasattr(value, "_fields"):
        return {"list" if isinstance(value, list) else "tuple": [inner(part, i) for i, part in enumerate(value)]}
    if isinstance(value, Mapping) and all(isinstance(key, str) for key in value):
        return {"dict": {str.__str__(key): inner(part, key) for key, part in value.items()}}
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = {field.name: inner(getattr(value, field.name), field.name) for field in dataclasses.fields(value)}
        return {"class": _name(type(value)), "fields": fields}
    raise ValueError(
        f"{place} is {type(value).__module__}.{type(value).__qualname__}; only data and dataclasses can be kept"
    )


def _name(cls: type) -> str:
    name = f"{cls.__module__}.{cls.__qualname__}"
    with contextlib.suppress(ValueError):
        if _class(name) is cls:
            return name
    raise ValueError(f"{name} is no class of millax; objects of other packages are not kept in files")


def _write(arrays: h5py.Group, place: str, array) -> dict[str, Any]:
    numbers = np.asarray(array)
    if numbers.dtype.kind not in NUMBERS:
        raise ValueError(f"{place} is an array of {numbers.dtype}; only arrays of numbers can be kept")
    name = place.replace("/", "_") or "array"
    while name in arrays:
        name += "_"
    kind = "jax" if isinstance(array, jax.Array) else "numpy" if isinstance(array, np.ndarray) else "scalar"
    # Sums round differently along rows and along columns: the order in memory is part of the number.
    columns = numbers.flags.f_contiguous and not numbers.flags.c_contiguous
    large = {"compression": "gzip", "shuffle": True} if numbers.nbytes >= COMPRESSED else {}
    arrays.create_dataset(name, data=numbers.T if columns else numbers, **large)
    return {"array": name, "kind": kind, "columns": columns}


# ---- from the structure to values


class _Arrays:
    """The arrays of a file; what was one array is one again."""

    def __init__(self, file: h5py.File):
        self._group = _linked(file, "arrays", h5py.Group)
        self._read: dict[tuple[str, str], Any] = {}

    def __call__(self, name: str, kind: str, columns: bool) -> Any:
        if (name, kind) not in self._read:
            numbers = np.asarray(_dataset(self._group, name)[()])
            if numbers.dtype.kind not in NUMBERS:
                raise ValueError(f"the dataset {name} is of {numbers.dtype}; it must be of numbers")
            numbers = numbers.T if columns else numbers
            made = numbers[()] if kind == "scalar" else jnp.asarray(numbers) if kind == "jax" else numbers
            if made.dtype != numbers.dtype:
                raise ValueError("its numbers are float64: call millax.set_up() before anything else")
            self._read[name, kind] = made
        return self._read[name, kind]


def restored(node: Any, arrays: _Arrays) -> Any:
    """The value that a node of the structure stands for. Raises `ValueError` for what is none."""
    match node:
        case None | bool() | int() | float() | str():
            return node
        case {"float": str(text)} if len(node) == 1:
            return float(text)
        case {"list": list(parts)} if len(node) == 1:
            return [restored(part, arrays) for part in parts]
        case {"tuple": list(parts)} if len(node) == 1:
            return tuple(restored(part, arrays) for part in parts)
        case {"dict": dict(parts)} if len(node) == 1:
            return {key: restored(part, arrays) for key, part in parts.items()}
        case {"class": str(name), "fields": dict(parts)} if len(node) == 2:
            return _object(_class(name), {key: restored(part, arrays) for key, part in parts.items()})
        case {"array": str(name), "kind": str(kind), "columns": bool(columns)} if len(node) == 3:
            return arrays(name, kind, columns)
    raise ValueError(f"its structure holds {json.dumps(node)[:80]}, which stands for nothing")


def _class(name: str) -> type:
    """The dataclass of millax or identification that is defined under this name."""
    found = OURS.fullmatch(name)
    if found:
        try:
            cls = getattr(importlib.import_module(found[1]), found[2], None)
        except ImportError:
            cls = None
        # Not what a module imports from elsewhere, and no function.
        if isinstance(cls, type) and dataclasses.is_dataclass(cls) and (cls.__module__, cls.__qualname__) == found.groups():
            return cls
    raise ValueError(f"{name} is no class of this version of millax")


def _object(cls: type, fields: dict[str, Any]) -> Any:
    hints = hints_of(cls)
    names = {field.name for field in dataclasses.fields(cls)}
    for what, odd in (("without", names - set(fields)), ("with the unknown", set(fields) - names)):
        if odd:
            raise ValueError(f"a {cls.__name__} {what} {', '.join(sorted(odd))} found")
    made = object.__new__(cls)
    for name, value in fields.items():
        if not fits(value, hints[name]):
            raise ValueError(f"{cls.__name__}.{name} must not be {type(value).__name__}")
        object.__setattr__(made, name, value)
    return made


def _dataset(group: h5py.Group, name: str) -> h5py.Dataset:
    """Raises `ValueError` where it is not, or its numbers lie in another file."""
    found = _linked(group, name, h5py.Dataset)
    if found.external or found.is_virtual:
        raise ValueError(f"the dataset {name} lies in another file")
    return found


def _linked(group: h5py.Group, name: str, kind: type) -> Any:
    """What a group itself holds under a name: not by a path, nor by a link to another place."""
    if "/" in name or not isinstance(group.get(name, getlink=True), h5py.HardLink):
        raise ValueError(f"it has no {kind.__name__.lower()} {name} of its own")
    found = group[name]
    if not isinstance(found, kind):
        raise ValueError(f"{name} is no {kind.__name__.lower()}")
    return found
