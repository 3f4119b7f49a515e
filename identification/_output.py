"""Results on disk and words on the terminal."""

import contextlib
import errno
import os
import tempfile
import warnings
from collections.abc import Iterator
from pathlib import Path

from rich.console import Console

console = Console(highlight=False, soft_wrap=True)
"""Standard output: colours and progress on a terminal, plain lines elsewhere."""

_stderr = Console(stderr=True, highlight=False, soft_wrap=True)


def complain(message: str) -> None:
    """Print an error."""
    _stderr.print("[bold red]error:[/] ", end="")
    # Messages name tables in brackets, which are not to be taken for markup.
    _stderr.print(message, markup=False)


@contextlib.contextmanager
def notes() -> Iterator[None]:
    """Print warnings as lines."""
    with warnings.catch_warnings():
        warnings.simplefilter("always", UserWarning)
        warnings.showwarning = lambda message, *_: console.print(f"note: {message}", markup=False)
        yield


@contextlib.contextmanager
def staged(folder: str | os.PathLike) -> Iterator[Path]:
    """A temporary directory whose files are moved into `folder` when the block ends well; otherwise nothing is left.

    `folder` is made if need be. Every file appears whole or not at all. Raises `OSError`, before the block runs, where
    nothing can be written.
    """
    target = Path(folder).absolute()
    if target.exists() and not target.is_dir():
        raise NotADirectoryError(errno.ENOTDIR, "this is a file; give a directory for the results", os.fspath(folder))
    # On the same file system as the target, so that moving is renaming.
    home = next(place for place in (target, *target.parents) if place.is_dir())
    with tempfile.TemporaryDirectory(prefix=".millax-", dir=home) as name:
        yield Path(name)
        target.mkdir(parents=True, exist_ok=True)
        for file in sorted(Path(name).iterdir()):
            file.replace(target / file.name)
