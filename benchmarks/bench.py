"""How fast millax is, beside other ways to compute the same: `make bench`.

    python -m benchmarks.bench [SUBJECT ...] [--long] [--write docs/speed.md]

Every figure is a ratio inside one run, of times taken in turn, since machines are noisy. Exit code 1 where a target is
missed.
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
    "single": "One simulation",
    "derivatives": "Derivatives",
    "batch": "Batches",
    "flags": "With the XLA flags of the command line",
    "light": "A light tool mode",
    "scaling": "Growth of the cost",
    "lobes": "A stability diagram from the time domain",
    "fits": "A fit",
    "precision": "Single precision",
    "memory": "Memory",
    "startup": "Start",
}

HEAD = """# Speed

Made by `make bench`, which prints these tables and fails where a target is missed.

The cut: a slot, 4 teeth, 3 passes remembered, 40 steps per tooth period, 10 000 rpm, 2 degrees of freedom, float64, unless
said otherwise. A ratio is the median over rounds in which all programs run in turn. Beside the engine:

- **C, same model**: the equations of millax as a plain scalar loop over time steps (`benchmarks/same_model.c`), one core,
  `gcc -O3 -march=native -ffast-math`. Converged, both agree to rounding.
- **C, sampled**: a simpler model (`benchmarks/sampled.c`): hard gates, the force sampled once in each step.
- **lax.scan over steps**: the same model, one step after the other (`benchmarks/scan.py`).
- **papers' grid**: the workpiece as nodes of 0 and 1 (`benchmarks/grid.py`).

![Time per step of everything beside the C loops, and growth of the cost](speed.png)
"""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("subjects", nargs="*", metavar="SUBJECT", help=f"one of {', '.join(SUBJECTS)} (default: all)")
    parser.add_argument("--long", action="store_true", help="measure in full what is otherwise extrapolated")
    parser.add_argument("--write", type=Path, metavar="FILE", help="also write a Markdown file, and a picture beside it")
    options = parser.parse_args()
    unknown = set(options.subjects) - set(SUBJECTS)
    if unknown:
        parser.error(f"unknown subject {', '.join(sorted(unknown))}; choose from {', '.join(SUBJECTS)}")

    from .figures import markdown, show
    from .speed.run import Run

    run, console, begin = Run(long=options.long), Console(width=130), time.perf_counter()
    pages, missed, count = [], [], 0
    for subject in options.subjects or SUBJECTS:
        figures = show(console, SUBJECTS[subject], importlib.import_module(f".speed.{subject}", __package__).figures(run))
        pages.append(markdown(SUBJECTS[subject], figures))
        missed += [figure for figure in figures if figure.met is False]
        count += sum(figure.met is not None for figure in figures)
        jax.clear_caches()
    made = (
        f"{count - len(missed)} of {count} targets met in {time.perf_counter() - begin:.0f} s; {platform.machine()}, "
        f"{run.cores} cores, Python {platform.python_version()}, JAX {jax.__version__}, NumPy {np.__version__}."
    )
    console.print(made)
    for figure in missed:
        console.print(f"missed: {figure.what}: {figure.measured}, target {figure.target}", style="bold red")
    if options.write:
        from .speed.picture import draw

        options.write.write_text("\n".join([HEAD, made, "", *pages]).rstrip() + "\n", encoding="utf-8")
        draw(run).savefig(options.write.with_suffix(".png"), dpi=110, metadata={"Software": None})
    return 1 if missed else 0


if __name__ == "__main__":
    raise SystemExit(main())
