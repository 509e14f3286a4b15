"""Starts and bodies at random, as every benchmark draws them."""
