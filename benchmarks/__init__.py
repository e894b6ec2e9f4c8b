"""Benchmarks: ``python -m benchmarks.NAME [--quick] [--json]``. Ratios of one run, both sides printed."""
