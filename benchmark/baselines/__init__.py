"""Plain methods to compare with. Each is one file of NumPy."""
