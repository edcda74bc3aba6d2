"""Measurements of camtopod, run as ``python -m bench PART`` from a checkout.

* one module a part, with ``main(argv) -> int``; its docstring says what it measures and how
* `bench.support`: code that several parts share
* `bench.scenes`: simulated scenes that are not networks of zones and paths
* `bench.baselines`: published methods to compare with

Results are in bench/README.md.
"""
