"""Other integrators, used as efficiently as we know how, on the same problems."""
