"""Accuracy of the results: labels, ω∞ and derivatives against independent computations."""
