"""Maps: grids and samples of starts, sweeps over them, and the stores on disk."""
