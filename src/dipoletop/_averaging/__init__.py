"""Averages over free rotation, and the slow flow that they drive, in the limit of weak radiation.

`free_rotation` holds the averages of the radiation over one period, in closed form.
"""
