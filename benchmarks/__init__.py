"""Programs that measure millax: `make validate` for what it gets right, `make bench` for how fast it is."""
