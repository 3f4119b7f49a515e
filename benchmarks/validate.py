"""Every figure that millax claims, measured and printed beside its target: `make validate`.

    python -m benchmarks.validate [SUBJECT ...] [--write docs/validation.md]

Exit code 1 where a target is missed.
"""

import importlib
import platform

import millax as mx

mx.set_up()

SUBJECTS = {
    "papers": "Closed forms and the papers' tables",
    "oracles": "Other programs, same cut",
    "paths": "Exact tooth paths and the papers' grid, same motion",
    "numerics": "Accuracy of the scheme",
    "surface": "Walls and entries",
    "gradients": "Gradients",
    "recovery": "Recovering known parameters",
    "posterior": "Posterior by sampling",
    "compliances": "Recovering joint compliances",
    "instrument": "Traces of an instrument",
    "coverage": "Honest intervals",
    "fits": "Fits from many starts",
    "design": "The next cut",
    "stability": "Limits of stability",
    "robot": "The robot at the tool",
    "programs": "Programs",
}


HEAD = "# Validation\n\nMade by `make validate`, which prints these tables and fails where a target is missed.\n"


def main() -> int:
    from .figures import chosen, command_line, report

    parser = command_line(__doc__, SUBJECTS, "also write the tables to a Markdown file")
    options = parser.parse_args()

    def figures_of(subject: str):
        return importlib.import_module(f".validation.{subject}", __package__).figures()

    met, text = report(chosen(parser, options, SUBJECTS), figures_of, platform.machine())
    if options.write:
        options.write.write_text(f"{HEAD}\n{text}", encoding="utf-8")
    return 0 if met else 1


if __name__ == "__main__":
    raise SystemExit(main())
