"""The command `millax`.

Exit codes: 0 done; 1 the answer is "no" (a simulation that must not be used, a fit that has not converged); 2 bad input;
130 interrupted.
"""

import argparse
import importlib.metadata
import sys
from collections.abc import Sequence

from ._runtime import prepare


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command line (default: that of the process) and return its exit code."""
    arguments = _parser().parse_args(argv)
    prepare()

    from millax import CaseError, SimulationError

    from ._measured import TraceError
    from ._output import complain, notes

    try:
        with notes():
            return arguments.run(arguments)
    except (CaseError, TraceError) as error:
        complain(str(error))
        return 2
    except OSError as error:
        complain(f"{error.filename}: {error.strerror}" if error.filename else str(error))
        return 2
    except SimulationError as error:
        complain(f"{arguments.case}: {error}")
        return 1
    except KeyboardInterrupt as interrupt:
        complain(f"interrupted: {interrupt}" if str(interrupt) else "interrupted")
        return 130


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="millax", description="A differentiable model of robotic milling.")
    parser.add_argument("--version", action="version", version=f"millax {importlib.metadata.version('millax')}")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)

    simulate = commands.add_parser(
        "simulate",
        help="simulate a cut",
        description="Simulate the cut that a case file describes. Writes trace.csv, summary.json and trace.png, and "
        "surface.png where the cut leaves a wall.",
    )
    _add_paths(simulate)
    simulate.add_argument("--chip-thickness", action="store_true", help="add the chip thickness of every tooth")
    simulate.set_defaults(run=_simulate)

    fit = commands.add_parser(
        "fit",
        help="identify parameters from measured traces and deflections",
        description="Fit the parameters named in the [fit] table of a case file to its traces and load tests. Writes "
        "result.json, fitted.toml (the case with the estimates in it), report.html and result.h5 (everything, for "
        "identification.load_result). A fit that was stopped goes on when the same command is run again.",
    )
    _add_paths(fit)
    fit.add_argument(
        "--no-check",
        action="store_true",
        help="begin also where the measurements cannot determine what is asked",
    )
    fit.add_argument("--starts", metavar="N", type=int, help="fit from N starts, in place of what [fit] says")
    fit.add_argument("--profile", action="store_true", default=None, help="intervals by profile likelihood, too")
    fit.add_argument("--posterior", metavar="N", type=int, help="N draws of the posterior, in place of what [fit] says")
    fit.add_argument("--restart", action="store_true", help="begin anew, whatever DIR/checkpoint.h5 holds")
    fit.set_defaults(run=_fit)

    check = commands.add_parser(
        "check",
        help="can the measurements say what is asked?",
        description="Before a fit: what may be wrong with the traces of a case file, which of the numbers in its [fit] "
        "table they can determine, and how well. Exit code 1 where something is wrong or cannot be known.",
    )
    check.add_argument("case", metavar="CASE.toml", help="the case file")
    check.set_defaults(run=_check)

    design = commands.add_parser(
        "design",
        help="the next cut: which one would tell most",
        description="Of all combinations of the numbers to vary, the cut that would make the parameters in the [fit] "
        "table of a case file best known, together with what was measured already, and how well, before it is made. "
        "Writes design.nc (labelled results) and design.png. Exit code 1 where no candidate can be ranked.",
    )
    _add_paths(design)
    design.add_argument(
        "--vary",
        metavar="NAME=VALUES",
        action="append",
        required=True,
        help='what can be chosen: "cut.spindle_speed=4000:16000:13 rpm" (from, to, how many), "cut.depth=0.5,1,2 mm" '
        '(a list) or one value; "robot.joints.joint_2=-80:-40:5 deg". May be repeated',
    )
    design.add_argument(
        "--criterion",
        metavar="D|A|NAME",
        default="D",
        help="what to make small: D the volume of the ellipsoid of confidence (default), A the sum of squared relative "
        "standard errors, or the standard error of one parameter, by its name",
    )
    design.add_argument("--count", metavar="N", type=int, default=1, help="plan N cuts, each the best after those before it")
    design.add_argument(
        "--channels", metavar="NAMES", help="what will be measured, Fx,Fy,x (default: as in the first trace)"
    )
    design.add_argument("--duration", metavar="TIME", help='of the recording, "0.3 s" (default: as the first trace)')
    design.add_argument("--rate", metavar="RATE", help='of sampling, "10 kHz" (default: as of the first trace)')
    design.add_argument(
        "--noise",
        metavar="NAME=VALUE",
        action="append",
        default=[],
        help='standard deviation of the noise of a channel, "Fx=2 N". May be repeated (default: as in the traces; where it '
        "is not known, 1 %% of the root mean square of the channel)",
    )
    design.set_defaults(run=_design)

    sweep = commands.add_parser(
        "sweep",
        help="simulate a cut many times with other numbers",
        description="Simulate the cut of a case file with every combination of other numbers, or with random ones. Writes "
        "labelled results (netCDF) and a picture beside them. A sweep that was stopped goes on when the same command is "
        "run again.",
    )
    sweep.add_argument("case", metavar="CASE.toml", help="the case file")
    sweep.add_argument(
        "--vary",
        metavar="NAME=VALUES",
        action="append",
        required=True,
        help='"cut.spindle_speed=4000:16000:49 rpm" (from, to, how many), "cut.depth=0.5,1,2 mm" (a list) or one value; '
        'with --samples "force.k0=4000:6000 N/mm^2" (uniform) or "force.k0=5000 +- 100 N/mm^2" (normal). May be repeated',
    )
    sweep.add_argument("--out", metavar="FILE.nc", required=True, help="file for the results")
    sweep.add_argument("--samples", metavar="N", type=int, help="N random members instead of a grid")
    sweep.add_argument("--seed", metavar="SEED", type=int, default=0, help="of the random members (default 0)")
    sweep.add_argument("--reduce", metavar="NAMES", help="what to keep, names between commas (default: everything there is)")
    sweep.add_argument("--overwrite", action="store_true", help="start anew, whatever the file holds")
    sweep.add_argument("--cluster", metavar="ADDRESS", help="of a Dask scheduler: compute on its workers")
    sweep.set_defaults(run=_sweep)

    stability = commands.add_parser(
        "stability",
        help="limits of stability: the lobe diagram",
        description="The axial depth at which the cut of a case file begins to chatter, over spindle speed, by up to three "
        "methods. Writes stability.nc (labelled results) and stability.png.",
    )
    _add_paths(stability)
    stability.add_argument(
        "--speeds",
        metavar="VALUES",
        help='spindle speeds: "5000:25000:101 rpm" (from, to, how many) or a list; by default around that of the case',
    )
    stability.add_argument(
        "--depths", metavar="VALUES", help='axial depths at which the spectral radius is kept, "0.1:5:40 mm"'
    )
    stability.add_argument(
        "--methods",
        metavar="NAMES",
        default="semi,floquet,time",
        help="names between commas: semi (semi-discretisation), floquet (multipliers of the time-domain model), time "
        "(growth in the time domain). Default: all of them",
    )
    stability.set_defaults(run=_stability)

    robot = commands.add_parser(
        "robot",
        help="what the tool feels of the robot that holds it",
        description="Stiffness, compliance, mass and modes at the tool of a case with a [robot], which joint gives way, and "
        "a map of stiffness over two joints. Writes robot.json, robot.nc (labelled results), robot.png and "
        "stiffness_map.png.",
    )
    _add_paths(robot)
    robot.add_argument(
        "--map",
        metavar="NAME=VALUES",
        action="append",
        default=[],
        help='a joint and its values, "robot.joints.joint_2=-120:-20:41 deg" (from, to, how many): give two. By default '
        "joints 2 and 3, between their limits or 45 degrees to both sides of the pose",
    )
    robot.set_defaults(run=_robot)
    return parser


def _add_paths(command: argparse.ArgumentParser) -> None:
    command.add_argument("case", metavar="CASE.toml", help="the case file")
    command.add_argument("--out", metavar="DIR", required=True, help="directory for the results; made if need be")


def _simulate(arguments: argparse.Namespace) -> int:
    from ._simulate_command import run_simulate

    return run_simulate(arguments.case, arguments.out, chip_thickness=arguments.chip_thickness)


def _sweep(arguments: argparse.Namespace) -> int:
    from ._sweep_command import run_sweep

    return run_sweep(
        arguments.case,
        arguments.vary,
        arguments.out,
        samples=arguments.samples,
        seed=arguments.seed,
        reduce=arguments.reduce,
        overwrite=arguments.overwrite,
        cluster=arguments.cluster,
    )


def _design(arguments: argparse.Namespace) -> int:
    from ._design_command import run_design

    return run_design(
        arguments.case,
        arguments.out,
        arguments.vary,
        criterion=arguments.criterion,
        count=arguments.count,
        channels=arguments.channels,
        duration=arguments.duration,
        rate=arguments.rate,
        noise=arguments.noise,
    )


def _stability(arguments: argparse.Namespace) -> int:
    from ._stability_command import run_stability

    return run_stability(
        arguments.case, arguments.out, speeds=arguments.speeds, depths=arguments.depths, methods=arguments.methods
    )


def _robot(arguments: argparse.Namespace) -> int:
    from ._robot_command import run_robot

    return run_robot(arguments.case, arguments.out, maps=arguments.map)


def _check(arguments: argparse.Namespace) -> int:
    from ._check_command import run_check

    return run_check(arguments.case)


def _fit(arguments: argparse.Namespace) -> int:
    from ._command import run_fit

    return run_fit(
        arguments.case,
        arguments.out,
        check=not arguments.no_check,
        restart=arguments.restart,
        starts=arguments.starts,
        profile=arguments.profile,
        posterior=arguments.posterior,
    )


if __name__ == "__main__":
    sys.exit(main())
