"""Maps: `sweep` computes the outcomes on a grid, listed points or a sample as a `Basin`.

`grids` and `problems` say what is swept, `sweep_plan` what is computed for each tile, and
`sweep_stores` where it is kept. `columns` is the schema of a basin, `store/` its format on disk,
and `unfolded_basins` extends a basin from one symmetry cell to the whole plane of starts.
"""
