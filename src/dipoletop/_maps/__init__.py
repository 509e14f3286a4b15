"""Maps: `sweep` computes the outcomes on a grid, listed points or a sample as a `Basin`.

`grids` and `problems` define the points of a sweep with their equations, `sweep_plan` computes each
tile, and `sweep_stores` keeps the results. `columns` is the schema of a basin, `store/` its format
on disk, and `unfolded_basins` extends a basin from one symmetry cell to the whole plane of starts.
"""
