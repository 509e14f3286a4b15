"""Costs of runs: time, steps, memory, compilation."""
