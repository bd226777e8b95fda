"""Perception of the object in depth pictures: table, mask, footprint, cells, and its pose push after push."""
