"""How precisely must a motion be known for its label? Costs, wrong labels, and doubt.

python -m benchmarks.accuracy.label_precision --small     a look
python -m benchmarks.accuracy.label_precision             all, eight minutes on two cores
python -m benchmarks.accuracy.label_precision --write     the same: results/label_precision.md
"""

from typing import Any

# heyoka's processes import this file again, so imports that take long are in the functions.


def measured(small: bool) -> dict[str, Any]:
    """Costs on the mixed basin, every level and kind of body, the separatrix."""
    from benchmarks.accuracy import label_costs, label_doubt

    return {
        "costs": label_costs.compare(small),
        "rows": label_doubt.compare(small),
        "wall": label_doubt.wall(small),
    }


if __name__ == "__main__":
    from benchmarks.reporting import pages

    pages.command("label_precision", measured)
