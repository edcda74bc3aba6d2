"""Simulated scenes modelled on real ones: a hall, a crowd, walkways and roads."""
