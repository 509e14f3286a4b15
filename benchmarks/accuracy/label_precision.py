"""How precisely must a motion be known for its label? Costs, wrong labels, and doubt.

python -m benchmarks.accuracy.label_precision --small     a look
python -m benchmarks.accuracy.label_precision             all, eight minutes on two cores
python -m benchmarks.accuracy.label_precision --write     the same: results/label_precision.md
"""

import argparse
from typing import Any

# heyoka's processes import this file again, so imports that take long are in the functions.


def measure_all(small: bool) -> dict[str, Any]:
    """Measure costs on the mixed basin, every level and kind of body, the separatrix."""
    from benchmarks.accuracy import label_costs, label_doubt
    from benchmarks.reporting import measure

    costs, doubt = label_costs.Sizes(), label_doubt.FULL
    if small:
        costs, doubt = label_costs.FEW, label_doubt.FEW
    return {
        "command": measure.command(),
        **measure.machine(),
        "costs": label_costs.compare(costs),
        "rows": label_doubt.compare(doubt),
        "wall": label_doubt.wall(doubt.wall, costs.tolerances),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--small", action="store_true", help="small sizes: does everything work?")
    parser.add_argument("--write", action="store_true", help="keep the results")
    args = parser.parse_args()
    if args.small and args.write:
        parser.error("--small measures nothing that is worth keeping, so it takes no --write")

    import jax

    jax.config.update("jax_enable_x64", True)
    from benchmarks.reporting import pages

    pages.show("label_precision", measure_all(args.small), keep=args.write)


if __name__ == "__main__":
    main()
