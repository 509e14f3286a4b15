"""Types and tools that all other parts use; no physics."""
