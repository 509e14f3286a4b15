"""How right the results are: labels, ω∞ and derivatives against independent computations."""
