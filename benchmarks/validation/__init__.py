"""The figures of `make validate`, one module per subject. Each has `figures()`, which yields `Figure`s."""
