"""Measurements: ``python -m bench PART``, from the checkout."""
