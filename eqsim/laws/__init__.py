"""Contact laws: the physics of one contact, each law in one place, for NumPy and for
the kernels."""
