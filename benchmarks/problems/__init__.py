"""Random starts and bodies for all benchmarks."""
