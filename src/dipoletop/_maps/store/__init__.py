"""Stores: basins on disk as Zarr groups; every bit is checked when it is read.

`layout` is the format on disk, `arrays` its arrays, `tiles` writes and reads it, `claims` parts the
work among processes, `headers` tells one sweep from another, `resume` begins or resumes a
sweep's store, and `contents` saves, loads and verifies whole basins. No module here knows `Basin`.
"""
