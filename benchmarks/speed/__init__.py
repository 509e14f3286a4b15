"""What runs cost: time, steps, memory, compilation."""
