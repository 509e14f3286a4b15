"""Words and tools that every other part shares; no physics in them."""
