"""Measure dipoletop and its peers in one run. What the numbers mean is in README.md here.

python benchmarks/run.py --small     some minutes, to see that everything works
python benchmarks/run.py             everything, printed; half an hour on two cores
python benchmarks/run.py --write     the same, and kept in results/
"""

import sys
from pathlib import Path
from typing import Any

if not __package__:  # started by its path: then its folder, not the repository, is on the path
    sys.path.insert(0, str(Path(__file__).parents[1]))

# The processes of a peer import this file again, so imports that take long are in the functions.


def measured(small: bool) -> dict[str, Any]:
    """Every part, one after another."""
    from benchmarks.reporting import measure
    from benchmarks.speed import (
        default_map,
        derivative_costs,
        fresh_outcomes,
        importing,
        outcomes,
        precision,
        scaling,
    )

    load_before = measure.load()
    fresh = {  # first, while this process is small
        "import": importing.compare(1 if small else 15),
        "fresh_outcomes": fresh_outcomes.compare(*((64, 1) if small else (4096, 5))),
        "maps": default_map.compare(small),
        "precision": precision.alone(small),
    }
    return fresh | {
        "basin": outcomes.compare(small),
        "scaling": scaling.compare(small),
        "gradients": derivative_costs.compare(small),
        "load": [load_before, measure.load()],
    }


if __name__ == "__main__":
    from benchmarks.reporting import pages

    pages.command("speed", measured)
