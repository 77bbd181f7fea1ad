"""Run the benchmarks named on the command line, or all of them, and print one table each.

Benchmarks with their own options, see ``python -m benchmarks NAME --help``: suite (published
optimal-control problems), torture (random tasks by seed), one_sided (arms with a weak side), scenes
(tasks among obstacles), published (published tasks among obstacles), sweep (overhead of a sweep),
switching_times (exact switching times of random tasks), replanning (re-plans of a moving arm),
plants (MuJoCo arms that differ from the model), layouts (designs of cells against exhaustive maps),
baseline (record of all answers, compared with an earlier one), ledger FILE (strategies in such a
record), prices (value of the data of a task).
"""

import argparse
import importlib
import subprocess
import sys

BENCHMARKS = (
    "rnea",
    "ik",
    "path_timing",
    "free_time_optimal",
    "arms",
    "closed_loop",
    "phases",
    "flames",
    "drake",
    "units",
    "cops_arm",
    "recording",
    "cell",
)


def main() -> None:
    """Run the chosen benchmarks; missed goals are printed, since a busy machine is no failure."""
    if sys.argv[1:2] == ["suite"]:
        importlib.import_module("benchmarks.suite.runner").main(sys.argv[2:])
        return
    if sys.argv[1:2] == ["ledger"]:
        sys.argv[1:2] = ["baseline", "--ledger"]
    own = ["baseline", "torture", "one_sided", "scenes", "sweep", "published", "switching_times"]
    own += ["layouts", "motionbenchmaker", "plants", "prices", "replanning"]
    own += [*(["cell"] if "--robot" in sys.argv else [])]
    if len(sys.argv) > 1 and sys.argv[1] in own:
        importlib.import_module(f"benchmarks.{sys.argv[1]}").main(sys.argv[2:])
        return
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(BENCHMARKS))
    parser.add_argument("--repetitions", type=int, default=0, help="default: each its own")
    options = parser.parse_args()
    names = options.names or BENCHMARKS
    for name in names:
        if name not in BENCHMARKS:
            parser.error(f"NAME must be one of {', '.join(BENCHMARKS)}, not {name!r}")
    if len(names) == 1:
        try:
            importlib.import_module(f"benchmarks.{names[0]}").run(options.repetitions)
        except ModuleNotFoundError as absent:
            sys.exit(f"{names[0]} needs {absent.name}, which is not installed")
        return
    for name in names:  # one process each, because threads of a peer would outlive its benchmark
        more = [name, "--repetitions", str(options.repetitions)]
        ended = subprocess.run([sys.executable, "-m", "benchmarks", *more], check=False)
        if ended.returncode:
            sys.exit(ended.returncode)


if __name__ == "__main__":
    main()
