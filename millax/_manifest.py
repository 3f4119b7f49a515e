"""What a sweep computes, as text: so that results are never mixed with those of another sweep."""

import dataclasses
import functools
import hashlib
import importlib.metadata
from collections.abc import Mapping
from typing import Any

import numpy as np

from ._case import Case
from ._members import Members

Manifest = dict[str, Any]
"""Everything that the results depend on, flat, as JSON can hold it."""


def manifest_of(case: Case, members: Members, fingerprints: Mapping[str, str], *, x64: bool) -> Manifest:
    """The manifest of a sweep. Blocks and sweeps are not in it: every member has its own."""
    numbers = dict(_flat("", case))
    for name in ("settings.blocks", "settings.sweeps"):
        numbers.pop(name, None)
    varied = {f"vary.{name}": _values(members, name) for name in members.names}
    kept = {f"reduce.{name}": digest for name, digest in fingerprints.items()}
    precision = "double" if x64 else "single"
    return {"millax": _version(), "precision": precision, **numbers, **varied, **kept}


@functools.cache
def _version() -> str:
    return importlib.metadata.version("millax")


def differences(old: Manifest, new: Manifest) -> list[str]:
    """What differs, one line each: "force.k0: 5e+09 → 6e+09"."""
    keys = [*old, *(key for key in new if key not in old)]
    return [
        f"{key}: the function has changed"
        if key.startswith("reduce.") and key in old and key in new
        else f"{key}: {old.get(key, 'none')} → {new.get(key, 'none')}"
        for key in keys
        if old.get(key) != new.get(key)
    ]


def digest(manifest: Manifest) -> str:
    """A hash of a manifest."""
    return hashlib.sha256(repr(sorted(manifest.items())).encode()).hexdigest()


def _flat(prefix: str, part: Any):
    """Fields of nested dataclasses by dotted names; arrays as nested lists."""
    if dataclasses.is_dataclass(part) and not isinstance(part, type):
        if prefix:
            yield prefix, type(part).__name__
        for field in dataclasses.fields(part):
            yield from _flat(f"{prefix}.{field.name}".lstrip("."), getattr(part, field.name))
    elif isinstance(part, str | int | None):
        yield prefix, part
    elif isinstance(part, tuple):
        yield prefix, list(part)
    else:
        yield prefix, np.asarray(part).tolist()


def _values(members: Members, name: str) -> str:
    dim, numbers = members.coordinates[name]
    unit = members.units[name]
    if dim is None:
        return f"{float(numbers):.12g} {unit}".strip()
    short = hashlib.sha256(np.ascontiguousarray(numbers, dtype="<f8").tobytes()).hexdigest()[:8]
    ends = f"{numbers.min():.6g} to {numbers.max():.6g} {unit}".strip()
    kind = "samples" if dim == "sample" else "values"
    return f"{len(numbers)} {kind} from {ends} (sha256 {short})"
