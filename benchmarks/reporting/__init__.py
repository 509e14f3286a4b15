"""Clocks, tables, and the pages in results/ that they are written to."""
