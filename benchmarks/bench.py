"""How fast millax is, beside other ways to compute the same: `make bench`.

    python -m benchmarks.bench [SUBJECT ...] [--long] [--write docs/speed.md]

Every figure is a ratio inside one run, of times taken in turn, since machines are noisy. Exit code 1 where a target is
missed.
"""

import importlib
import platform

import jax

import millax as mx

mx.set_up()

SUBJECTS = {
    "single": "One simulation",
    "derivatives": "Derivatives",
    "batch": "Batches",
    "plain": "Without `millax.set_up`",
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

Everything is measured after `millax.set_up()`, as the commands `millax` set up JAX; what it is without stands in a table of
its own. The cut: a slot, 4 teeth, 3 passes remembered, 40 steps per tooth period, 10 000 rpm, 2 degrees of freedom, float64,
unless said otherwise. A ratio is the median over rounds in which all programs run in turn. Beside the engine:

- **C, same model**: the equations of millax as a plain scalar loop over time steps (`benchmarks/same_model.c`), one core,
  `gcc -O3 -march=native -ffast-math`. Converged, both agree to rounding.
- **C, sampled**: a simpler model (`benchmarks/sampled.c`): hard gates, the force sampled once in each step.
- **lax.scan over steps**: the same model, one step after the other (`benchmarks/scan.py`).
- **papers' grid**: the workpiece as nodes of 0 and 1 (`benchmarks/grid.py`).

![Time per step of everything beside the C loops, and growth of the cost](speed.png)
"""


def main() -> int:
    from .figures import chosen, command_line, report
    from .speed.run import Run

    parser = command_line(__doc__, SUBJECTS, "also write a Markdown file, and a picture beside it")
    parser.add_argument("--long", action="store_true", help="measure in full what is otherwise extrapolated")
    options = parser.parse_args()
    run = Run(long=options.long)

    def figures_of(subject: str):
        yield from importlib.import_module(f".speed.{subject}", __package__).figures(run)
        jax.clear_caches()

    met, text = report(chosen(parser, options, SUBJECTS), figures_of, f"{platform.machine()}, {run.cores} cores")
    if options.write:
        from .speed.picture import draw

        options.write.write_text(f"{HEAD}\n{text}", encoding="utf-8")
        draw(run).savefig(options.write.with_suffix(".png"), dpi=110, metadata={"Software": None})
    return 0 if met else 1


if __name__ == "__main__":
    raise SystemExit(main())
