"""Benchmarks of dipoletop. How to run them is in README.md."""
