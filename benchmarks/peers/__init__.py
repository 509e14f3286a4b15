"""Other integrators, driven as fast as we know how, on the same problems."""
