"""Benchmarks: what a line costs on an instrument, and what the engine itself costs."""
