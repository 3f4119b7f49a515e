"""Every figure that millax claims, measured and printed beside its target: `make validate`.

    python -m benchmarks.validate [SUBJECT ...] [--write docs/validation.md]

Exit code 1 where a target is missed.
"""

import argparse
import importlib
import platform
import time
from pathlib import Path

import jax
import numpy as np
from rich.console import Console

jax.config.update("jax_enable_x64", True)

SUBJECTS = {
    "papers": "Closed forms and the papers' tables",
    "oracles": "Other programs, same cut",
    "numerics": "Accuracy of the scheme",
    "gradients": "Gradients",
    "recovery": "Recovering known parameters",
    "programs": "Programs",
}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("subjects", nargs="*", metavar="SUBJECT", help=f"one of {', '.join(SUBJECTS)} (default: all)")
    parser.add_argument("--write", type=Path, metavar="FILE", help="also write the tables to a Markdown file")
    options = parser.parse_args()
    unknown = set(options.subjects) - set(SUBJECTS)
    if unknown:
        parser.error(f"unknown subject {', '.join(sorted(unknown))}; choose from {', '.join(SUBJECTS)}")

    from .figures import markdown, show

    console, begin = Console(width=130), time.perf_counter()
    pages, missed, count = [], [], 0
    for subject in options.subjects or SUBJECTS:
        figures = show(console, SUBJECTS[subject], importlib.import_module(f".validation.{subject}", __package__).figures())
        pages.append(markdown(SUBJECTS[subject], figures))
        missed += [figure for figure in figures if figure.met is False]
        count += sum(figure.met is not None for figure in figures)
    made = (
        f"{count - len(missed)} of {count} targets met in {time.perf_counter() - begin:.0f} s; Python "
        f"{platform.python_version()}, JAX {jax.__version__}, NumPy {np.__version__}, {platform.machine()}."
    )
    console.print(made)
    for figure in missed:
        console.print(f"missed: {figure.what}: {figure.measured}, target {figure.target}", style="bold red")
    if options.write:
        head = "# Validation\n\nMade by `make validate`, which prints these tables and fails where a target is missed.\n"
        options.write.write_text("\n".join([head, made, "", *pages]).rstrip() + "\n", encoding="utf-8")
    return 1 if missed else 0


if __name__ == "__main__":
    raise SystemExit(main())
