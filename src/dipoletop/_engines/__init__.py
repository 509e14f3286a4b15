"""Engines: many trajectories at once, from their starts to their end states."""
