"""Events -> topology -> prediction. Deterministic: no I/O, no clock, no threads, no hidden randomness."""
