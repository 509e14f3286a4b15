"""Stores: basins on disk as Zarr groups; every bit is checked when it is read.

`layout` is the format on disk and `arrays` its arrays; `tiles` writes and reads it; `claims`
divides the work among processes; `headers` tells one sweep from another; `resume` begins or
resumes a sweep's store; `status` shows how far it is; `saved_basins` saves, loads and verifies
basins. No module here knows `Basin`.
"""
