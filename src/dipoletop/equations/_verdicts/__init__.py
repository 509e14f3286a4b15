"""Verdicts: the regions of state space that decide the outcome, with ω∞ and its error."""
