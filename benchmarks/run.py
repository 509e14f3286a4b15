"""All benchmarks in one run: dipoletop beside its peers. What they mean is in README.md here.

python benchmarks/run.py --small     some minutes, to see that everything works
python benchmarks/run.py             everything, printed
python benchmarks/run.py --write     and kept: README.md, results/, the figure
"""

import argparse
import itertools
from typing import Any

# A peer's processes import this file again, so what takes long is imported in the functions.


def measure_all(small: bool, large: bool) -> dict[str, Any]:
    """Every scene, one after another."""
    import bench_basin
    import bench_gradients
    import bench_import
    import bench_map
    import bench_precision
    import bench_savings
    import bench_scaling
    import measure

    sizes = bench_basin.ErrorScale((4096, 32768, 262_144), slow=1024, truth=1024, repeats=5)
    points = [512, 1024] if large else [512]
    precision: dict[str, Any] = {"n": 16384, "repeats": 7}
    savings, scaling = bench_savings.ErrorScale(), bench_scaling.ErrorScale()
    gradients = bench_gradients.ErrorScale()
    if large:
        scaling = scaling._replace(maps=(*scaling.maps, (2048, "native", False)))
        gradients = gradients._replace(body=True)
    if small:
        few = ("heyoka batch", "diffrax vmap chunked, tuple", "diffrax vmap whole, (3,)")
        sizes = bench_basin.ErrorScale((256,), slow=32, truth=16, repeats=1, rivals=few)
        points = [16]
        precision = {"n": 64, "repeats": 2, "tolerances": (1e-6, 1e-9)}
        savings, scaling = bench_savings.FEW, bench_scaling.FEW
        gradients = bench_gradients.FEW
    before = measure.load()
    # Fresh processes first, while this one is small.
    importing = bench_import.compare(1 if small else 15)
    scenes = itertools.product(points, bench_map.LEVELS, bench_map.ENGINES)
    maps = [bench_map.measured(level, n, engine) for n, level, engine in scenes]
    fresh = bench_scaling.in_fresh_processes(scaling)
    return {
        "machine": measure.machine(),
        "import": importing,
        "maps": maps,
        "precision": bench_precision.alone(**precision),
        "basin": bench_basin.compare(sizes),
        "scaling": fresh | bench_scaling.compare(scaling),
        "gradients": bench_gradients.compare(gradients),
        "savings": bench_savings.compare(savings),
        "load": [before, measure.load()],
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    size = parser.add_mutually_exclusive_group()
    size.add_argument("--small", action="store_true", help="small sizes: does everything work?")
    size.add_argument("--large", action="store_true", help="larger maps too")
    parser.add_argument("--write", action="store_true", help="keep the results")
    args = parser.parse_args()
    if args.small and args.write:
        parser.error("--small measures nothing that is worth keeping, so it takes no --write")

    import jax

    jax.config.update("jax_enable_x64", True)
    import report

    results = measure_all(args.small, args.large)
    text = report.markdown(results)
    print(text)
    if args.write:
        report.keep("results", text, results)
        report.figure(results["precision"])


if __name__ == "__main__":
    main()
