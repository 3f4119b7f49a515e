"""What `make bench` measures, one subject per file: `figures(run)` yields the lines of its table."""
