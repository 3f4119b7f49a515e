"""Recordings of a dynamometer, fitted: see `benchmarks.measured_slot`."""
