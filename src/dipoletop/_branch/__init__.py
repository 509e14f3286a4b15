"""The physical branch of the full equations, window by window."""
