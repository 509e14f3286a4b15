"""Stores: basins on disk as Zarr groups; every bit is checked when it is read.

`layout` is the format on disk and `arrays` its arrays; `tiles` writes and reads it; `claims`
divides the work among processes; `headers` identifies sweeps; `saved_basins` begins or resumes a
sweep's store, and saves, loads and verifies basins. No module here imports `Basin`.
"""
