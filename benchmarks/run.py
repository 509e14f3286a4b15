"""Measure dipoletop and its peers in one run. What the numbers mean is in README.md here.

python benchmarks/run.py --small     some minutes, to see that everything works
python benchmarks/run.py             everything, printed; half an hour on two cores
python benchmarks/run.py --write     the same, and kept in results/
"""

import argparse
import itertools
import sys
from pathlib import Path
from typing import Any

if not __package__:  # started by its path: then its folder, not the repository, is on the path
    sys.path.insert(0, str(Path(__file__).parents[1]))

# The processes of a peer import this file again, so imports that take long are in the functions.


def measure_all(small: bool, large: bool) -> dict[str, Any]:
    """Every part, one after another."""
    from benchmarks import engines
    from benchmarks.reporting import measure
    from benchmarks.speed import (
        default_map,
        derivative_costs,
        fresh_outcomes,
        importing,
        outcomes,
        precision,
        savings,
        scaling,
    )

    sizes = outcomes.Sizes((4096, 32768, 262_144), slow=1024, truth=1024, repeats=5)
    points = [512, 1024] if large else [512]
    precision_sizes: dict[str, Any] = {"n": 16384, "repeats": 7}
    savings_sizes, scaling_sizes = savings.Sizes(), scaling.Sizes()
    derivative_sizes = derivative_costs.Sizes()
    if large:
        scaling_sizes = scaling_sizes._replace(maps=(*scaling_sizes.maps, (2048, "native", False)))
        derivative_sizes = derivative_sizes._replace(body=True)
    if small:
        few = ("heyoka batch", "diffrax vmap chunked, tuple", "diffrax vmap whole, (3,)")
        sizes = outcomes.Sizes((256,), slow=32, truth=16, repeats=1, rivals=few)
        points = [16]
        precision_sizes = {"n": 64, "repeats": 2, "tolerances": (1e-6, 1e-9)}
        savings_sizes, scaling_sizes = savings.FEW, scaling.FEW
        derivative_sizes = derivative_costs.FEW
    load_before = measure.load()
    # Fresh processes first, while this one is small.
    import_times = importing.compare(1 if small else 15)
    cold_start = importing.cold_start(1, 16) if small else importing.cold_start(9)
    fresh_processes = fresh_outcomes.compare(64, 1) if small else fresh_outcomes.compare(4096, 5)
    maps = [
        default_map.measured(level, n, engine)
        for n, level, engine in itertools.product(points, default_map.LEVELS, engines.NAMES)
    ]
    fresh = scaling.in_fresh_processes(scaling_sizes)
    return {
        "machine": measure.machine(),
        "import": import_times,
        "cold_start": cold_start,
        "fresh_outcomes": fresh_processes,
        "maps": maps,
        "precision": precision.alone(**precision_sizes),
        "basin": outcomes.compare(sizes),
        "scaling": fresh | scaling.compare(scaling_sizes),
        "gradients": derivative_costs.compare(derivative_sizes),
        "savings": savings.compare(savings_sizes),
        "load": [load_before, measure.load()],
    }


def main() -> None:
    """Measure, print, and keep if asked."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    size = parser.add_mutually_exclusive_group()
    size.add_argument("--small", action="store_true", help="small sizes: does everything work?")
    size.add_argument("--large", action="store_true", help="larger maps too")
    parser.add_argument("--write", action="store_true", help="keep the results")
    args = parser.parse_args()
    if args.small and args.write:
        parser.error("--small measures nothing that is worth keeping, so it takes no --write")

    import jax

    jax.config.update("jax_enable_x64", True)
    from benchmarks.reporting import pages

    pages.show("speed", measure_all(args.small, args.large), keep=args.write)


if __name__ == "__main__":
    main()
