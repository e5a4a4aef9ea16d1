"""Benchmarks: how long each job takes, beside what one would use instead, measured in the same run."""
