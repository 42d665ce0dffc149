"""The same operations as `kernel.reference` in the same order, on arrays: one row for each axis, bit-equal."""
