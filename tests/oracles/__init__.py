"""Slow float64 oracles, written from the equations, with nothing of jaxtrack but data types."""
