"""Benchmarks. Run all with `make bench`, some with `make bench ARGS="core"`.

Compare figures within one run; between runs and machines compare ratios only.
"""
