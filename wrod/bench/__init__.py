"""Benchmarks: one file per `wrod bench NAME`."""
