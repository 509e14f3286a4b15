"""Runs: one trajectory, its outcome, the outcomes of many starts, and their derivatives."""
