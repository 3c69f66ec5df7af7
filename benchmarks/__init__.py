"""Timings. Run all with `make bench`, some with `make bench ARGS="wire"`.

Figures of one run belong together; between runs and machines only ratios mean something.
"""
